# SPDX-License-Identifier: Apache-2.0
"""The time of a bag that is played: it runs at a rate, stands while paused, and jumps; wall time is an argument."""

from __future__ import annotations

from dataclasses import dataclass, replace


@dataclass(frozen=True)
class Timeline:
    """Maps wall time (s, of a clock that never jumps) to bag time (ns since the epoch).

    Attributes:
        bag_ns: bag time at `wall`.
        wall: s.
        rate: bag time that passes in a second of wall time, s.
        paused: whether bag time stands.
    """

    bag_ns: int
    wall: float
    rate: float = 1.0
    paused: bool = False

    def at(self, wall: float) -> int:
        """Bag time at a wall time."""
        if self.paused:
            return self.bag_ns
        return self.bag_ns + round((wall - self.wall) * self.rate * 1e9)

    def wall_at(self, bag_ns: int) -> float:
        """Wall time at which a bag time is reached; infinite while paused."""
        if self.paused:
            return float("inf")
        return self.wall + (bag_ns - self.bag_ns) * 1e-9 / self.rate

    def pause(self, wall: float) -> Timeline:
        """Bag time stands from a wall time on."""
        return replace(self, bag_ns=self.at(wall), wall=wall, paused=True)

    def resume(self, wall: float) -> Timeline:
        """Bag time runs from a wall time on."""
        return replace(self, bag_ns=self.at(wall), wall=wall, paused=False)

    def jump(self, bag_ns: int, wall: float) -> Timeline:
        """Bag time is another one from a wall time on."""
        return replace(self, bag_ns=bag_ns, wall=wall)
