# SPDX-License-Identifier: Apache-2.0
"""Chooses a gait of a front: the paper's three, and the best at a wanted speed or power."""

from __future__ import annotations

import enum
import math
from collections.abc import Sequence
from dataclasses import dataclass

from worm_optimizer.robustness.prediction import Prediction
from worm_optimizer.search.optimizer_errors import OptimizerError

_TOLERANCE = 1e-9  # relative; a wanted value that was read off a front must be reachable


class Objective(enum.IntEnum):
    """What a gait is wanted for; the values are those of worm_msgs/RequestGait."""

    MIN_POWER = 0
    CRUISE = 1
    MAX_SPEED = 2
    MIN_POWER_AT_SPEED = 3
    MAX_SPEED_AT_POWER = 4


@dataclass(frozen=True)
class Request:
    """A wanted gait; ``value`` is the speed in m/s or the power in W of the last two objectives.

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
class Choice:
    """The answer to a request: a gait, or the nearest reachable one and in ``refusal`` why it is not it."""

    prediction: Prediction
    refusal: str = ""


def three_gaits(front: Sequence[Prediction]) -> dict[str, Prediction]:
    """The paper's minimum-power, cruising and maximum-speed gaits of a front, by name."""
    objectives = (Objective.MIN_POWER, Objective.CRUISE, Objective.MAX_SPEED)
    return {each.name.lower(): select(front, Request(each)).prediction for each in objectives}


def select(front: Sequence[Prediction], request: Request) -> Choice:
    """Chooses from a front of at least one gait."""
    thriftiest = min(front, key=lambda gait: gait.power)
    fastest = max(front, key=lambda gait: gait.speed)
    match request.objective:
        case Objective.MIN_POWER:
            return Choice(thriftiest)
        case Objective.CRUISE:
            return Choice(min(front, key=lambda gait: gait.cost_of_transport))
        case Objective.MAX_SPEED:
            return Choice(fastest)
        case Objective.MIN_POWER_AT_SPEED:
            least = request.value * (1.0 - _TOLERANCE)
            reaching = [gait for gait in front if gait.speed >= least]
            if reaching:
                return Choice(min(reaching, key=lambda gait: gait.power))
            return Choice(fastest, _too_fast(request.value, fastest))
        case Objective.MAX_SPEED_AT_POWER:
            most = request.value * (1.0 + _TOLERANCE)
            affordable = [gait for gait in front if gait.power <= most]
            if affordable:
                return Choice(max(affordable, key=lambda gait: gait.speed))
            return Choice(thriftiest, _too_little(request.value, thriftiest))


def _too_fast(speed: float, fastest: Prediction) -> str:
    return (
        f"no gait of the front reaches {speed:.6g} m/s: the fastest makes {fastest.speed:.6g} m/s "
        f"(margin {1e3 * fastest.margin:.2f} mm); ask for no more"
    )


def _too_little(power: float, lowest: Prediction) -> str:
    return (
        f"no gait of the front moves with {power:.6g} W: the lowest power is {lowest.power:.6g} W "
        f"(margin {1e3 * lowest.margin:.2f} mm); ask for at least that"
    )
