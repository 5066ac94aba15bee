# SPDX-License-Identifier: Apache-2.0
"""Gate through which all goal positions pass to the servos. It withholds goals that are out of bounds."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

from worm_driver.errors import LimitError
from worm_driver.servos.position_track import PositionTrack
from worm_driver.servos.registers import COMMON
from worm_driver.servos.servo_bus import ServoBus

_GOAL = COMMON["goal_position"]


@dataclass(frozen=True)
class Bound:
    """Bounds of one servo's goals.

    Attributes:
        low, high: range of the position, ticks. For a cable these are the limits of the stroke.
        lead: largest distance of a goal from the last plausible position, ticks.
        speed: growth of that distance with the age of the position, ticks/s, as the servo moves on unobserved.
    """

    low: int
    high: int
    lead: float = math.inf
    speed: float = 0.0


class GoalGate:
    """Writer of goals that stay within their bounds.

    A goal out of bounds is withheld. The servo keeps its previous goal, which was within the bounds. If a goal is too
    far from the position, the following error also exceeds its limit, and the supervision reports that. A servo whose
    position is lost gets no goal at all, as its ticks may now stand for another position.

    Attributes:
        bounds: bounds by servo id. Servos without bounds get no goal.
    """

    def __init__(self, bus: ServoBus, track: PositionTrack):
        self._bus = bus
        self._track = track
        self._sent: dict[int, int] = {}
        self.bounds: Mapping[int, Bound] = {}

    def write(self, servo: int, ticks: int) -> None:
        """Write a goal with acknowledgement, outside of the cycle, for example before the torque is enabled.

        Raises:
            LimitError: The goal is out of bounds.
            BusError: The servo does not acknowledge it.
        """
        if not self._is_within(servo, ticks):
            bound = self.bounds[servo]
            raise LimitError(
                f"servo {servo}: goal {ticks} ticks is out of its range of {bound.low} to {bound.high} ticks: bring "
                "the cable to its initial length and call the service home, or turn the fin into its range"
            )
        self._bus.write(servo, _GOAL, ticks)
        self._sent[servo] = ticks

    def send(self, goals: Mapping[int, int]) -> None:
        """Write goals (ticks by servo id) in one packet.

        Raises:
            BusError: The packet cannot be sent.
        """
        within = {servo: ticks for servo, ticks in goals.items() if self._is_within(servo, ticks)}
        self._bus.count_withheld(len(goals) - len(within))
        self._bus.sync_write(_GOAL, within)
        self._sent.update(within)

    def last_sent(self, servo: int) -> int | None:
        """Return the last goal (ticks) that was written to a servo, None before the first one."""
        return self._sent.get(servo)

    def _is_within(self, servo: int, ticks: int) -> bool:
        bound, last = self.bounds.get(servo), self._track.last(servo)
        if bound is None or last is None or servo in self._track.lost:
            return False
        if not bound.low <= ticks <= bound.high:
            return False
        unseen = max(0.0, self._bus.now() - last.time)
        return abs(ticks - last.ticks) <= bound.lead + bound.speed * unseen
