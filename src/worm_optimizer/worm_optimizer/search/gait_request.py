# SPDX-License-Identifier: Apache-2.0
"""Requests for gaits and their exact answers: a front's three gaits, and the best gait at a speed or a power.

A robot at rest at another length has another groove phase, which determines how many grooves a stroke gains
(`docs/model.md`). A request may state that length.
"""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass, replace

import numpy as np

from worm_model.gait import FORWARD, REVERSE
from worm_model.parameters import ParameterFile
from worm_optimizer.optimizer_errors import OptimizerError
from worm_optimizer.robustness.prediction import Prediction
from worm_optimizer.search.exact import Cost
from worm_optimizer.search.front import RobustFront

SAME_LENGTH = 1e-4  # m; lengths that differ by less are equal, as a camera is not more accurate
_TOLERANCE = 1e-9  # relative; a value of a front, rounded, must be reachable


class Objective(enum.IntEnum):
    """Objective of a requested gait; the values are those of worm_msgs/RequestGait."""

    MIN_POWER = 0
    CRUISE = 1
    MAX_SPEED = 2
    MIN_POWER_AT_SPEED = 3
    MAX_SPEED_AT_POWER = 4


class RequestStatus(enum.IntEnum):
    """Outcome of a request; the values are those of worm_msgs/RequestGait."""

    DONE = 0
    INVALID = 1
    NO_FRONT = 3
    UNREACHABLE = 4


@dataclass(frozen=True)
class GaitRequest:
    """Requested gait; ``value`` is the speed in m/s or the power in W for the last two objectives.

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
    """Answer to a request: a gait, or the reason why there is none and the nearest reachable one, if any."""

    status: RequestStatus
    message: str = ""
    prediction: Prediction | None = None


def request_of(objective: int, speed: float, power: float) -> GaitRequest:
    """Return the request for an objective, with speed in m/s or power in W if the objective needs it.

    Raises `OptimizerError` on an unknown objective or a value that no gait can have.
    """
    try:
        known_objective = Objective(objective)
    except ValueError:
        known = ", ".join(f"{each.value} {each.name}" for each in Objective)
        raise OptimizerError(f"objective: {objective} is none of {known}") from None
    values = {Objective.MIN_POWER_AT_SPEED: speed, Objective.MAX_SPEED_AT_POWER: power}
    return GaitRequest(known_objective, values.get(known_objective, math.nan))


def check_direction(direction: int) -> None:
    """Raise `OptimizerError` unless the direction is one of the two."""
    if direction not in (FORWARD, REVERSE):
        raise OptimizerError(
            f"direction: {direction} is neither {FORWARD} (forward) nor {REVERSE} (reverse)"
        )


def resting_content(content: ParameterFile, initial_length: float) -> ParameterFile:
    """Return the parameters with the initial length in m of a robot at rest. 0 or the same length changes nothing.

    Raises `OptimizerError` if the length differs from the parameters' by half of it or more.
    """
    known = content.parameters.initial_length
    if not initial_length or abs(initial_length - known) < SAME_LENGTH:
        return content
    if not abs(initial_length - known) < known / 2.0:
        raise OptimizerError(
            f"initial_length: {initial_length} m is far from the parameters' {known} m"
        )
    return replace(content, parameters=content.parameters.replace(initial_length=initial_length))


def select(front: RobustFront, request: GaitRequest) -> GaitAnswer:
    """Answer a request exactly, on the edges of a front's branches."""
    match request.objective:
        case Objective.MIN_POWER_AT_SPEED:
            found = front.exact.cheapest(at_speed(request.value))
            nearest = _too_fast(request.value, front.max_speed)
        case Objective.MAX_SPEED_AT_POWER:
            found = front.exact.cheapest(at_power(request.value))
            nearest = _too_little(request.value, front.min_power)
        case _:
            return GaitAnswer(
                RequestStatus.DONE, prediction=front.three[request.objective.name.lower()]
            )
    if not len(found):
        return nearest
    (prediction,) = front.predicted(found)
    return GaitAnswer(RequestStatus.DONE, prediction=prediction)


def at_speed(speed: float) -> Cost:
    """Return the cost for requests at a speed in m/s: the power of gaits at least as fast."""
    least = speed * (1.0 - _TOLERANCE)
    return lambda points: np.where(points.speed >= least, points.power, np.inf)


def at_power(power: float) -> Cost:
    """Return the cost for requests at a power in W: the negative speed of gaits that need at most this power."""
    most = power * (1.0 + _TOLERANCE)
    return lambda points: np.where(points.power <= most, -points.speed, np.inf)


def _too_fast(speed: float, fastest: Prediction) -> GaitAnswer:
    return GaitAnswer(
        RequestStatus.UNREACHABLE,
        f"no gait of the front reaches {speed:.6g} m/s: the fastest makes {fastest.speed:.6g} m/s "
        f"(margin {1e3 * fastest.margin:.2f} mm); request at most that",
        fastest,
    )


def _too_little(power: float, lowest: Prediction) -> GaitAnswer:
    return GaitAnswer(
        RequestStatus.UNREACHABLE,
        f"no gait of the front moves with {power:.6g} W: the lowest power is {lowest.power:.6g} W "
        f"(margin {1e3 * lowest.margin:.2f} mm); request at least that",
        lowest,
    )
