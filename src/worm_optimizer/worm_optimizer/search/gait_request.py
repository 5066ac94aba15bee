# SPDX-License-Identifier: Apache-2.0
"""Requests for gaits and their answers: the paper's three gaits of a front, and the best at a speed or a power."""

from __future__ import annotations

import enum
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from worm_model.gait import FORWARD, REVERSE
from worm_optimizer.robustness.prediction import Prediction
from worm_optimizer.search.front import RobustFront
from worm_optimizer.search.optimizer_errors import OptimizerError

_TOLERANCE = 1e-9  # relative; a wanted value that was read off a front must be reachable


class Objective(enum.IntEnum):
    """What a gait is wanted for; the values are those of worm_msgs/RequestGait."""

    MIN_POWER = 0
    CRUISE = 1
    MAX_SPEED = 2
    MIN_POWER_AT_SPEED = 3
    MAX_SPEED_AT_POWER = 4


class RequestStatus(enum.IntEnum):
    """How a request ended; the values are those of worm_msgs/RequestGait."""

    DONE = 0
    INVALID = 1
    COMPUTING = 2
    NO_FRONT = 3
    UNREACHABLE = 4


@dataclass(frozen=True)
class GaitRequest:
    """A gait that is asked for; ``value`` is the speed in m/s or the power in W of the last two objectives.

    Raises `OptimizerError` on a value that no gait can have.
    """

    objective: Objective
    value: float = math.nan

    def __post_init__(self) -> None:
        if self.objective is Objective.MIN_POWER_AT_SPEED and not 0.0 <= self.value < math.inf:
            raise OptimizerError(
                f"speed: {self.value} m/s: give a finite number that is not negative"
            )
        if self.objective is Objective.MAX_SPEED_AT_POWER and not 0.0 < self.value < math.inf:
            raise OptimizerError(f"power: {self.value} W: give a finite positive number")


@dataclass(frozen=True)
class GaitAnswer:
    """The answer to a request: a gait, or why there is none and the nearest reachable one, if any."""

    status: RequestStatus
    message: str = ""
    prediction: Prediction | None = None


def request_of(objective: int, speed: float, power: float) -> GaitRequest:
    """The request of plain numbers; speed in m/s and power in W, each looked at where it matters.

    Raises `OptimizerError` on an unknown objective or a value that no gait can have.
    """
    try:
        known_objective = Objective(objective)
    except ValueError:
        known = ", ".join(f"{each.value} {each.name}" for each in Objective)
        raise OptimizerError(f"objective: {objective} is none of {known}") from None
    values = {Objective.MIN_POWER_AT_SPEED: speed, Objective.MAX_SPEED_AT_POWER: power}
    return GaitRequest(known_objective, values.get(known_objective, math.nan))


def answer(
    fronts: Mapping[int, RobustFront],
    absences: Mapping[int, GaitAnswer],
    direction: int,
    request: GaitRequest,
) -> GaitAnswer:
    """Answers from the front of a direction; ``absences`` say why there may be none yet."""
    if direction not in (FORWARD, REVERSE):
        message = f"direction: {direction} is neither {FORWARD} (forward) nor {REVERSE} (reverse)"
        return GaitAnswer(RequestStatus.INVALID, message)
    front = fronts.get(direction)
    if front is None:
        return absences[direction]
    chosen = select(front.predictions, request)
    if chosen.status is not RequestStatus.DONE or chosen.prediction is None:
        return chosen
    margin = 1e3 * chosen.prediction.margin
    return replace(chosen, message=f"margin {margin:.2f} mm, {front.reason}")


def three_gaits(front: Sequence[Prediction]) -> dict[str, Prediction]:
    """The paper's minimum-power, cruising and maximum-speed gaits of a front of at least one, by name."""
    return {
        "min_power": min(front, key=lambda gait: gait.power),
        "cruise": min(front, key=lambda gait: gait.cost_of_transport),
        "max_speed": max(front, key=lambda gait: gait.speed),
    }


def select(front: Sequence[Prediction], request: GaitRequest) -> GaitAnswer:
    """Chooses from a front of at least one gait."""
    three = three_gaits(front)
    match request.objective:
        case Objective.MIN_POWER_AT_SPEED:
            least = request.value * (1.0 - _TOLERANCE)
            fast_enough = [gait for gait in front if gait.speed >= least]
            if not fast_enough:
                return _too_fast(request.value, three["max_speed"])
            chosen = min(fast_enough, key=lambda gait: gait.power)
        case Objective.MAX_SPEED_AT_POWER:
            most = request.value * (1.0 + _TOLERANCE)
            affordable = [gait for gait in front if gait.power <= most]
            if not affordable:
                return _too_little(request.value, three["min_power"])
            chosen = max(affordable, key=lambda gait: gait.speed)
        case _:
            chosen = three[request.objective.name.lower()]
    return GaitAnswer(RequestStatus.DONE, prediction=chosen)


def _too_fast(speed: float, fastest: Prediction) -> GaitAnswer:
    return GaitAnswer(
        RequestStatus.UNREACHABLE,
        f"no gait of the front reaches {speed:.6g} m/s: the fastest makes {fastest.speed:.6g} m/s "
        f"(margin {1e3 * fastest.margin:.2f} mm); ask for no more",
        fastest,
    )


def _too_little(power: float, lowest: Prediction) -> GaitAnswer:
    return GaitAnswer(
        RequestStatus.UNREACHABLE,
        f"no gait of the front moves with {power:.6g} W: the lowest power is {lowest.power:.6g} W "
        f"(margin {1e3 * lowest.margin:.2f} mm); ask for at least that",
        lowest,
    )
