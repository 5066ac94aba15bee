# SPDX-License-Identifier: Apache-2.0
"""Requests for gaits and their exact answers: the three gaits of a front, and the best gait at a speed or a power.

The length of the robot at rest determines its groove phase, and so the number of grooves that a stroke gains
(`docs/model.md`). A request of the service `RequestGait` can therefore contain this length.
"""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, assert_never

import numpy as np

from worm_model.errors import InputError
from worm_model.gait import FORWARD, REVERSE
from worm_model.parameters import ParameterFile
from worm_optimizer.gait_prediction import Prediction

if TYPE_CHECKING:  # these imports would take half of the time in which `operate` starts
    from worm_optimizer.search.exact import Cost
    from worm_optimizer.search.front import RobustFront

# Initial lengths that differ by less than this count as equal, m. A camera is not more accurate.
SAME_LENGTH = 1e-4
# Relative tolerance of a requested speed or power, so that a rounded value of the front is still reachable
_TOLERANCE = 1e-9


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
    """Request for a gait; ``value`` is the speed in m/s or the power in W that the last two objectives need.

    Raises `InputError` for a value that no gait can have.
    """

    objective: Objective
    value: float = math.nan

    def __post_init__(self) -> None:
        if self.objective is Objective.MIN_POWER_AT_SPEED and not 0.0 <= self.value < math.inf:
            raise InputError(f"speed: {self.value} m/s: give a finite number that is not negative")
        if self.objective is Objective.MAX_SPEED_AT_POWER and not 0.0 < self.value < math.inf:
            raise InputError(f"power: {self.value} W: give a finite positive number")


@dataclass(frozen=True)
class GaitAnswer:
    """Answer to a request.

    Attributes:
        status: outcome.
        message: reason if the request failed. `select` leaves it empty for a request that succeeded.
        prediction: requested gait. If the request is unreachable, the nearest gait; None if there is none.
    """

    status: RequestStatus
    message: str = ""
    prediction: Prediction | None = None


def request_of(objective: int, speed: float, power: float) -> GaitRequest:
    """Return the request for an objective, with the speed in m/s or the power in W if the objective needs it.

    Raises `InputError` for an unknown objective or a value that no gait can have.
    """
    try:
        known_objective = Objective(objective)
    except ValueError:
        known = ", ".join(f"{each.value} {each.name}" for each in Objective)
        raise InputError(f"objective: {objective} is none of {known}") from None
    values = {Objective.MIN_POWER_AT_SPEED: speed, Objective.MAX_SPEED_AT_POWER: power}
    return GaitRequest(known_objective, values.get(known_objective, math.nan))


def checked_direction(direction: int) -> int:
    """Return a direction. Raises `InputError` if it is neither `FORWARD` nor `REVERSE`."""
    if direction not in (FORWARD, REVERSE):
        raise InputError(
            f"direction: {direction} is neither {FORWARD} (forward) nor {REVERSE} (reverse)"
        )
    return direction


def resting_content(content: ParameterFile, initial_length: float) -> ParameterFile:
    """Return parameters whose initial length (m) is the given one, which was measured on a robot at rest.

    The result is ``content`` itself if the given length is 0, or differs by less than `SAME_LENGTH` from the length in
    ``content``. Raises `InputError` if the difference is at least half the length in ``content``.
    """
    known = content.parameters.initial_length
    if not initial_length or abs(initial_length - known) < SAME_LENGTH:
        return content
    if not abs(initial_length - known) < known / 2.0:
        raise InputError(
            f"initial_length: {initial_length} m is far from the {known} m of the parameters: check value and unit"
        )
    return replace(content, parameters=content.parameters.replace(initial_length=initial_length))


def select(front: RobustFront, request: GaitRequest) -> GaitAnswer:
    """Return the exact answer to a request. The gait at a speed or power may lie between two of ``front.gaits``."""
    match request.objective:
        case Objective.MIN_POWER_AT_SPEED:
            found = front.exact.cheapest(at_speed(request.value))
            nearest = front.three["max_speed"]
            reason = (
                f"no gait of the front reaches {request.value:.6g} m/s: the fastest reaches {nearest.speed:.6g} m/s "
                f"(margin {1e3 * nearest.margin:.2f} mm); request at most this speed"
            )
        case Objective.MAX_SPEED_AT_POWER:
            found = front.exact.cheapest(at_power(request.value))
            nearest = front.three["min_power"]
            reason = (
                f"no gait of the front moves with {request.value:.6g} W: the lowest power is {nearest.power:.6g} W "
                f"(margin {1e3 * nearest.margin:.2f} mm); request at least this power"
            )
        case Objective.MIN_POWER | Objective.CRUISE | Objective.MAX_SPEED:
            return GaitAnswer(
                RequestStatus.DONE, prediction=front.three[request.objective.name.lower()]
            )
        case _:
            assert_never(request.objective)
    if not len(found):
        return GaitAnswer(RequestStatus.UNREACHABLE, reason, nearest)
    (prediction,) = front.predicted(found)
    return GaitAnswer(RequestStatus.DONE, prediction=prediction)


def at_speed(speed: float) -> Cost:
    """Return the `Cost` of a request for the lowest power at a speed (m/s): the power, infinite for slower gaits."""
    least = speed * (1.0 - _TOLERANCE)
    return lambda points: np.where(points.speed >= least, points.power, np.inf)


def at_power(power: float) -> Cost:
    """Return the `Cost` of a request for the highest speed at a power (W): minus the speed, infinite at more power."""
    most = power * (1.0 + _TOLERANCE)
    return lambda points: np.where(points.power <= most, -points.speed, np.inf)
