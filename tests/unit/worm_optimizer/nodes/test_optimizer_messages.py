# SPDX-License-Identifier: Apache-2.0
"""Conversion to and from the messages of worm_msgs."""

import dataclasses
import math

import pytest
from gaits_for_tests import QUICK

from worm_model.errors import InputError
from worm_msgs.action import OptimizeGaits, ScanMargin
from worm_msgs.msg import Gait, GaitPrediction
from worm_msgs.srv import RequestGait
from worm_optimizer.gait_prediction import Prediction
from worm_optimizer.nodes import optimizer_messages
from worm_optimizer.search.gait_request import GaitAnswer, Objective, RequestStatus
from worm_optimizer.search.price_of_robustness import Cliff, MarginPoint, PriceOfRobustness
from worm_optimizer.search.search_settings import Robustness

GAIT_FIELDS = set(Gait.get_fields_and_field_types())


def test_every_field_of_the_message_is_a_field_of_the_prediction():
    of_message = set(GaitPrediction.get_fields_and_field_types()) - {"gait"} | GAIT_FIELDS
    assert of_message == {row.name for row in dataclasses.fields(Prediction)}


def test_objectives_and_statuses_have_the_numbers_of_the_message():
    for part, kinds in ((RequestGait.Request, Objective), (RequestGait.Response, RequestStatus)):
        assert all(getattr(part, kind.name) == kind.value for kind in kinds)


def test_an_answer_without_a_gait_has_no_figures():
    response = optimizer_messages.fill_response(
        RequestGait.Response(), GaitAnswer(RequestStatus.NO_FRONT, "why")
    )
    assert (response.success, response.message) == (False, "why")
    assert response.status == RequestGait.Response.NO_FRONT
    assert math.isnan(response.prediction.speed)
    assert math.isnan(response.prediction.success_probability)


@pytest.mark.parametrize(
    ("goal", "changes"),
    [
        ({"margin": math.nan}, {"seed": 0}),  # no default, as 0 is seed 0
        ({"margin": 1e-3, "seed": 5}, {"margin": 1e-3, "seed": 5}),
        (
            {"seed": 5, "margin": math.nan, "robustness": "chance", "probability": 0.9},
            {"seed": 5, "robustness": Robustness.CHANCE, "probability": 0.9},
        ),
    ],
)
def test_a_goal_sets_its_settings_and_the_others_keep_their_defaults(goal, changes):
    settings = optimizer_messages.settings_of_goal(QUICK, OptimizeGaits.Goal(**goal))
    assert QUICK.seed != 0
    assert settings == dataclasses.replace(QUICK, **changes)


@pytest.mark.parametrize(
    ("goal", "expected"),
    [
        ({"seed": 2**40}, "seed"),
        ({"robustness": "luck"}, "none of margin, chance, any_phase"),
    ],
)
def test_an_invalid_goal_is_rejected(goal, expected):
    with pytest.raises(InputError, match=expected):
        optimizer_messages.settings_of_goal(QUICK, OptimizeGaits.Goal(**goal))


def test_a_scans_margins_are_the_goals_or_the_defaults():
    plain = optimizer_messages.scan_of_goal(QUICK, ScanMargin.Goal(lowest=1e-3))
    assert dataclasses.astuple(plain.scan) == (1e-3, QUICK.scan.highest, QUICK.scan.step)
    given = optimizer_messages.scan_of_goal(QUICK, ScanMargin.Goal(highest=2e-3, step=5e-4))
    assert given.scan.margins().tolist() == [0.0, 5e-4, 1e-3, 1.5e-3, 2e-3]
    with pytest.raises(InputError, match="scan:"):
        optimizer_messages.scan_of_goal(QUICK, ScanMargin.Goal(lowest=math.nan))


def test_the_result_of_a_scan():
    nothing = MarginPoint(2e-3, math.nan, math.nan, math.nan, 0.0, ())
    points = (MarginPoint(1e-3, 50.0, 0.07, 0.2, 2.0, (1.0, 2.0)), nothing)
    message = optimizer_messages.scan_result(
        PriceOfRobustness(points, Cliff(1.5e-3, 1e-3, 2e-3, math.inf, 2.0), 1.4e-3, 1.1e-3)
    )
    assert message.success
    assert list(message.margins) == [1e-3, 2e-3]
    assert list(message.optimal_branch) == [2, 0]
    assert message.cost_of_transport[0] == 50.0
    assert math.isnan(message.cost_of_transport[1])
    assert (message.cliff_margin, message.lost_branch) == (1.5e-3, 2)
    without = optimizer_messages.scan_result(PriceOfRobustness(points[:1], None, 1.4e-3, 1.1e-3))
    assert math.isnan(without.cliff_margin)
    assert "no cliff" in without.message
