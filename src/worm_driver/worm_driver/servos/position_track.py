# SPDX-License-Identifier: Apache-2.0
"""Last plausible position of each servo, and the check whether the servo can have moved from there to a new sample."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

from worm_driver.servos.registers import TICKS_PER_TURN

#: Ratio of the highest plausible speed of a shaft to its velocity limit. It is above 1, because a load may turn the
#: shaft faster than the motor does.
_SPEED_RATIO = 2.0
#: Difference between two positions that is always plausible, ticks. It covers errors of the times of reception: at the
#: velocity limits of the supported models, a delay of 1 ms causes a difference of 3 to 7 ticks.
_TOLERANCE = 64


@dataclass(frozen=True)
class PositionSample:
    """Plausible position.

    Attributes:
        ticks: position, raw.
        time: time at which it was received, s, monotonic.
    """

    ticks: int
    time: float


class PositionTrack:
    """Plausible positions of servos by id.

    Between `begin` and `end`, while the torque is on, a sample is rejected if the servo cannot have moved to it since
    the last plausible position. At other times every sample is accepted, because a person may turn the spool at any
    speed.

    Args:
        fastest: velocity limits, rad/s by servo id.

    Attributes:
        lost: servos whose position was implausible in two successive readings. The value is the second position minus
            the last plausible one, ticks by servo id. All samples of such a servo are rejected until `begin` or
            `end`. Otherwise every wrong position would become plausible as time passes.
    """

    def __init__(self, fastest: Mapping[int, float]):
        self._fastest = dict(fastest)
        self._last: dict[int, PositionSample] = {}
        self._watches = False
        self.lost: dict[int, int] = {}

    def begin(self, positions: Mapping[int, PositionSample]) -> None:
        """Begin to reject implausible samples. ``positions`` are the first plausible positions by servo id.

        Two readings must have agreed on each of these positions.
        """
        self._last.update(positions)
        self._watches = True
        self.lost.clear()

    def end(self) -> None:
        """Accept every sample from now on, because the torque is off."""
        self._watches = False
        self.lost.clear()

    def last(self, servo: int) -> PositionSample | None:
        """Return the last plausible position of a servo, None before the first one."""
        return self._last.get(servo)

    def record_if_plausible(self, servo: int, ticks: int, time: float) -> bool:
        """Record a sample received at a time (s) and return True, or return False if it is implausible."""
        if self._watches and not self._is_plausible(servo, ticks, time):
            return False
        self._last[servo] = PositionSample(ticks, time)
        return True

    def mark_lost(self, servo: int, ticks: int) -> None:
        """Reject all further samples of a servo whose second reading (ticks) was implausible, too."""
        self.lost.setdefault(servo, ticks - self._last[servo].ticks)

    def _is_plausible(self, servo: int, ticks: int, time: float) -> bool:
        last = self._last.get(servo)
        if servo in self.lost:
            return False
        return last is None or is_reachable(last, ticks, time, self._fastest[servo])


def is_reachable(last: PositionSample, ticks: int, time: float, fastest: float) -> bool:
    """Return True if a servo can have moved from the position ``last`` to a position (ticks) by a time (s).

    ``fastest`` is the velocity limit of the servo, rad/s.
    """
    turned = _SPEED_RATIO * fastest * max(0.0, time - last.time) / math.tau * TICKS_PER_TURN
    return abs(ticks - last.ticks) <= turned + _TOLERANCE
