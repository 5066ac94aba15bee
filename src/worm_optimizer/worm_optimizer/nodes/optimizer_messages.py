# SPDX-License-Identifier: Apache-2.0
"""Conversion between this package's values and the messages of worm_msgs."""

from __future__ import annotations

import dataclasses
import math
from typing import Any, TypeVar

from worm_msgs.action import OptimizeGaits, ScanMargin
from worm_msgs.msg import Gait, GaitPrediction
from worm_msgs.srv import RequestGait
from worm_optimizer.robustness.prediction import Prediction
from worm_optimizer.search.front import Progress, RobustFront
from worm_optimizer.search.gait_request import GaitAnswer, RequestStatus, three_gaits
from worm_optimizer.search.nsga2 import SearchSettings
from worm_optimizer.search.optimizer_errors import OptimizerError
from worm_optimizer.search.price_of_robustness import CLIFF_RULE, PriceOfRobustness
from worm_optimizer.search.search_settings import ScanSettings, Settings, robustness_of

_GAIT_FIELDS = frozenset({"stroke", "frequency", "direction", "margin"})

T = TypeVar("T")


def value_of(kind: type[T], *messages: Any, **known: Any) -> T:
    """A dataclass with the fields of its names of messages, of the first one that has it, but for what is known."""
    names = {row.name for row in dataclasses.fields(kind)} - known.keys()  # type: ignore[arg-type]
    taken = {n: getattr(m, n) for m in reversed(messages) for n in names if hasattr(m, n)}
    return kind(**taken, **known)


def prediction_message(prediction: Prediction) -> GaitPrediction:
    """The message of a prediction; the names and units are the same on both sides."""
    values = dataclasses.asdict(prediction)
    gait = Gait(**{name: values.pop(name) for name in _GAIT_FIELDS})
    return GaitPrediction(gait=gait, **values)


def fill_response(response: RequestGait.Response, answer: GaitAnswer) -> RequestGait.Response:
    """Puts an answer into a response; without a prediction its numbers are NaN."""
    response.success = answer.status is RequestStatus.DONE
    response.status = answer.status.value
    response.message = answer.message
    if answer.prediction is not None:
        response.prediction = prediction_message(answer.prediction)
    else:
        response.prediction = _no_prediction()
    return response


def _no_prediction() -> GaitPrediction:
    names = {row.name for row in dataclasses.fields(Prediction)} - _GAIT_FIELDS
    return GaitPrediction(**dict.fromkeys(names, math.nan))


def settings_of_goal(base: Settings, goal: OptimizeGaits.Goal) -> Settings:
    """The settings that a goal asks for, the node's own where it leaves them open.

    Raises `OptimizerError` on values that are not admissible.
    """
    search = SearchSettings(
        population=int(goal.population) or base.search.population,
        generations=int(goal.generations) or base.search.generations,
        seed=int(goal.seed),
    )
    return dataclasses.replace(
        base,
        search=search,
        margin=None if math.isnan(goal.margin) else goal.margin,
        robustness=robustness_of(goal.robustness) if goal.robustness else base.robustness,
        probability=goal.probability or base.probability,
    )


def direction_of(value: int) -> int:
    """A goal's direction; raises `OptimizerError` on anything else than the two."""
    if value not in (Gait.FORWARD, Gait.REVERSE):
        raise OptimizerError(
            f"direction: {value} is neither {Gait.FORWARD} (forward) nor {Gait.REVERSE} (reverse)"
        )
    return int(value)


def scan_of_goal(base: Settings, goal: ScanMargin.Goal) -> Settings:
    """The settings with the margins that a goal asks for; raises `OptimizerError` as `ScanSettings` does."""
    margins = ScanSettings(
        goal.lowest, goal.highest or base.scan.highest, goal.step or base.scan.step
    )
    return dataclasses.replace(base, scan=margins)


def optimize_feedback(progress: Progress) -> OptimizeGaits.Feedback:
    """How far an optimisation is; within the search, the feedback of a generation."""
    return OptimizeGaits.Feedback(
        fraction=progress.fraction,
        generation=progress.generation,
        generations=progress.generations,
        hypervolume=progress.hypervolume,
        front_size=progress.front_size,
    )


def scan_feedback(progress: Progress) -> ScanMargin.Feedback:
    """How far a scan is."""
    return ScanMargin.Feedback(fraction=progress.fraction)


def optimize_result(front: RobustFront) -> OptimizeGaits.Result:
    """The result of an optimisation."""
    three = {
        name: prediction_message(gait) for name, gait in three_gaits(front.predictions).items()
    }
    return OptimizeGaits.Result(
        success=True,
        message=f"margin {1e3 * front.margin:.2f} mm, {front.reason}, source {front.source}",
        margin=front.margin,
        hypervolume_share=front.hypervolume_share,
        missed_branches=list(front.missed_branches),
        source=front.source,
        front=[prediction_message(gait) for gait in front.predictions],
        **three,
    )


def scan_result(price: PriceOfRobustness) -> ScanMargin.Result:
    """The result of a margin scan."""
    cliff = price.cliff
    return ScanMargin.Result(
        success=True,
        message=CLIFF_RULE if cliff else f"the scan has no cliff: {CLIFF_RULE}",
        margins=[point.margin for point in price.points],
        cost_of_transport=[point.cost_of_transport for point in price.points],
        optimal_branch=[point.branch for point in price.points],
        cliff_margin=cliff.margin if cliff else math.nan,
        lost_branch=cliff.lost_branch if cliff else 0,
        closed_form_cliff_margin=price.closed_form_cliff_margin,
        groove_phase=price.groove_phase,
    )
