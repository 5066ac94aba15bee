# SPDX-License-Identifier: Apache-2.0
"""Conversion between dataclasses of this package and the messages of worm_msgs."""

from __future__ import annotations

import dataclasses
import math

from worm_msgs.action import OptimizeGaits, ScanMargin
from worm_msgs.gait import GAIT_UNITS
from worm_msgs.msg import Gait, GaitPrediction
from worm_msgs.srv import RequestGait
from worm_optimizer.gait_prediction import Prediction
from worm_optimizer.search.front import RobustFront, price_warning
from worm_optimizer.search.gait_request import GaitAnswer, RequestStatus
from worm_optimizer.search.price_of_robustness import CLIFF_RULE, PriceOfRobustness
from worm_optimizer.search.search_settings import (
    Robustness,
    ScanSettings,
    Settings,
    Waveform,
)


def prediction_message(prediction: Prediction) -> GaitPrediction:
    """Return the message of a prediction. The fields of both have the same names and units."""
    values = dataclasses.asdict(prediction)
    gait = Gait(**{name: values.pop(name) for name in GAIT_UNITS})
    return GaitPrediction(gait=gait, **values)


def fill_response(response: RequestGait.Response, answer: GaitAnswer) -> RequestGait.Response:
    """Copy an answer to a response, and return the response.

    If the answer has no prediction, the predicted numbers are NaN.
    """
    response.success = answer.status is RequestStatus.DONE
    response.status = answer.status.value
    response.message = answer.message
    if answer.prediction is not None:
        response.prediction = prediction_message(answer.prediction)
    else:
        response.prediction = _no_prediction()
    return response


def _no_prediction() -> GaitPrediction:
    names = {row.name for row in dataclasses.fields(Prediction)} - set(GAIT_UNITS)
    return GaitPrediction(**dict.fromkeys(names, math.nan))


def settings_of_goal(base: Settings, goal: OptimizeGaits.Goal) -> Settings:
    """Return the settings of the node (``base``), changed by a goal.

    Seed and margin are always those of the goal. If the goal contains no margin (NaN, and a force of 0), the last
    margin of the scan before the cliff is used. If the waveform, the robustness or the probability of the goal is empty
    or 0, the value in ``base`` applies.
    """
    return dataclasses.replace(
        base,
        seed=int(goal.seed),
        margin=None if math.isnan(goal.margin) else goal.margin,
        margin_force=goal.margin_force or None,
        waveform=Waveform(goal.waveform) if goal.waveform else base.waveform,
        robustness=Robustness(goal.robustness) if goal.robustness else base.robustness,
        probability=goal.probability or base.probability,
    )


def scan_of_goal(base: Settings, goal: ScanMargin.Goal) -> Settings:
    """Return the settings of the node (``base``) with the margins of a goal.

    If ``highest`` or ``step`` of the goal is 0, the value in ``base`` applies. Raises `InputError` if the
    margins are inadmissible.
    """
    margins = ScanSettings(
        goal.lowest, goal.highest or base.scan.highest, goal.step or base.scan.step
    )
    return dataclasses.replace(base, scan=margins)


def with_warning(message: str, warning: str) -> str:
    """Return a message with a warning, which may be empty, at its end."""
    return f"{message}; warning: {warning}" if warning else message


def optimize_result(front: RobustFront) -> OptimizeGaits.Result:
    """Return the result message of the computation of a front."""
    three = {name: prediction_message(gait) for name, gait in front.three.items()}
    return OptimizeGaits.Result(
        success=True,
        message=with_warning(front.described, front.warning(front.three.values())),
        margin=front.margin,
        front=[prediction_message(gait) for gait in front.gaits],
        **three,
    )


def scan_result(price: PriceOfRobustness) -> ScanMargin.Result:
    """Return the result message of a margin scan."""
    cliff = price.cliff
    return ScanMargin.Result(
        success=True,
        message=with_warning(
            CLIFF_RULE if cliff else f"the scan has no cliff: {CLIFF_RULE}", price_warning(price)
        ),
        margins=[point.margin for point in price.points],
        cost_of_transport=[point.cost_of_transport for point in price.points],
        optimal_branch=[point.branch for point in price.points],
        cliff_margin=cliff.margin if cliff else math.nan,
        lost_branch=cliff.lost_branch if cliff else 0.0,
        closed_form_cliff_margin=price.closed_form_cliff_margin,
        groove_phase=price.groove_phase,
    )
