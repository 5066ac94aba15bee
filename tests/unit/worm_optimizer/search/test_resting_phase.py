# SPDX-License-Identifier: Apache-2.0
"""A request for where the robot rests: the gait gains its grooves there, where the front's own may not."""

import dataclasses

import pytest

from worm_model.parameters import PAPER, ParameterFile
from worm_optimizer.search.cache import Cache
from worm_optimizer.search.front import make_front, task_of
from worm_optimizer.search.gait_map import MapSettings
from worm_optimizer.search.gait_request import GaitRequest, Objective, RequestStatus
from worm_optimizer.search.nsga2 import SearchSettings
from worm_optimizer.search.optimizer_errors import OptimizerError
from worm_optimizer.search.resting_phase import resting_answer
from worm_optimizer.search.search_settings import Settings

CONTENT = ParameterFile()
SETTINGS = Settings(
    margin=0.002, map=MapSettings(41, 9, 1e-5, 1), search=SearchSettings(24, 10, 1), samples=20
)
CRUISE = GaitRequest(Objective.CRUISE)


@pytest.fixture(scope="module")
def front(tmp_path_factory: pytest.TempPathFactory):
    cache = Cache.at(tmp_path_factory.mktemp("cache"))
    return make_front(CONTENT, SETTINGS, 1, cache, lambda _: None)


@pytest.mark.parametrize("shift", [-0.006, -0.002, 0.003, 0.007])
def test_the_gait_gains_with_its_margin_what_is_promised_at_the_phase_of_the_robot(front, shift):
    length = PAPER.initial_length + shift
    answer = resting_answer(front, CONTENT, SETTINGS, CRUISE, length)
    gait = answer.prediction
    assert answer.status is RequestStatus.DONE
    assert gait.margin == front.margin
    here = dataclasses.replace(
        CONTENT, parameters=dataclasses.replace(PAPER, initial_length=length)
    )
    table = (
        task_of(here, SETTINGS, 1).with_margin(front.margin).table([gait.stroke], [gait.frequency])
    )
    assert gait.speed == pytest.approx(table.speed[0], rel=1e-9)
    assert gait.grooves_per_cycle >= 0.95
    pitch = PAPER.pitch
    phase = (length + pitch / 2) % pitch - pitch / 2
    assert gait.groove_phase == pytest.approx(phase, abs=1e-9)


def test_at_the_phase_of_the_parameters_it_is_about_the_fronts_own(front):
    own = min(front.predictions, key=lambda gait: gait.cost_of_transport)
    found = resting_answer(front, CONTENT, SETTINGS, CRUISE, PAPER.initial_length).prediction
    assert found.cost_of_transport == pytest.approx(own.cost_of_transport, rel=0.05)


def test_a_length_of_another_robot_is_refused(front):
    for length in (float("nan"), 0.0, 1.2):
        with pytest.raises(OptimizerError, match="initial_length"):
            resting_answer(front, CONTENT, SETTINGS, CRUISE, length)
