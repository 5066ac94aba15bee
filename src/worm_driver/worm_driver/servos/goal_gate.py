# SPDX-License-Identifier: Apache-2.0
"""Gate through which all goal positions pass to the servos. It withholds goals that are out of bounds."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

from worm_driver.driver_errors import RejectedError
from worm_driver.servos.position_track import PositionTrack
from worm_driver.servos.registers import COMMON
from worm_driver.servos.servo_bus import ServoBus

_GOAL = COMMON["goal_position"]


@dataclass(frozen=True)
class Bound:
    """Bounds of one servo's goals.

    Attributes:
        low, high: smallest and largest goal, ticks. For a cable servo: the range of the stroke, with a tolerance.
        lead: largest distance of a goal from the last plausible position if this position was just received, ticks.
        speed: ticks/s. For each second since the last plausible position was received, the largest distance of a goal
            from it grows by this amount, because the servo may have moved on.
    """

    low: int
    high: int
    lead: float = math.inf
    speed: float = 0.0


class GoalGate:
    """Writer of goals that stay within their bounds.

    A goal out of bounds is withheld. The servo keeps its previous goal, which was within the bounds when it was sent.

    If a goal of a cable servo is too far from the last plausible position, the following error (distance of the cable
    from its command) exceeds its limit, too. `control.fault_watch` reports this as a fault.

    A servo gets no goal before its first plausible position. It also gets none while its position is lost
    (`PositionTrack.lost`), because a number of ticks may then stand for another position than before.

    Attributes:
        bounds: bounds by servo id. A servo without bounds gets no goal.
    """

    def __init__(self, bus: ServoBus, track: PositionTrack):
        self._bus = bus
        self._track = track
        self._sent: dict[int, int] = {}
        self.bounds: Mapping[int, Bound] = {}

    def write(self, servo: int, ticks: int) -> None:
        """Write a goal (ticks) and wait for the acknowledgement. For use outside of the control cycle."""
        if why := self._why_withheld(servo, ticks):
            raise RejectedError(f"servo {servo}: goal {ticks} ticks is withheld: {why}")
        self._bus.write(servo, _GOAL, ticks)
        self._sent[servo] = ticks

    def send(self, goals: Mapping[int, int]) -> None:
        """Write goals (ticks by servo id) in one packet, without acknowledgement. Withheld goals are counted."""
        within = {
            servo: ticks for servo, ticks in goals.items() if not self._why_withheld(servo, ticks)
        }
        self._bus.count(withheld=len(goals) - len(within))
        self._bus.sync_write(_GOAL, within)
        self._sent.update(within)

    def last_sent(self, servo: int) -> int | None:
        """Return the last goal (ticks) that was written to a servo, None before the first one."""
        return self._sent.get(servo)

    def _why_withheld(self, servo: int, ticks: int) -> str:
        """Return the reason why a goal is withheld; empty if it is within the bounds."""
        bound, last = self.bounds.get(servo), self._track.last(servo)
        if bound is None:
            return "the servo has no bounds"
        if last is None or servo in self._track.lost:
            return "the position of the servo is unknown"
        if not bound.low <= ticks <= bound.high:
            return (
                f"it is not within {bound.low} to {bound.high} ticks: bring the cable to its initial length and call "
                "the service home, or turn the fin into its range"
            )
        reach = bound.lead + bound.speed * max(0.0, self._bus.now() - last.time)
        if abs(ticks - last.ticks) > reach:
            return f"it is more than {reach:.0f} ticks from the last position, {last.ticks} ticks"
        return ""
