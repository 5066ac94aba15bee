# SPDX-License-Identifier: Apache-2.0
"""Time of a bag during playback, with rate, pause and jumps. The caller passes the wall time."""

from __future__ import annotations

from dataclasses import dataclass, replace


@dataclass(frozen=True)
class Timeline:
    """Mapping of wall time (s, of a monotonic clock) to bag time (ns since the epoch).

    Attributes:
        bag_ns: bag time at the wall time `wall`, ns since the epoch.
        wall: wall time of the last change of the timeline, s.
        rate: bag time per wall time, s/s.
        paused: True if bag time is stopped.
    """

    bag_ns: int
    wall: float
    rate: float = 1.0
    paused: bool = False

    def at(self, wall: float) -> int:
        """Return the bag time (ns) at a wall time (s)."""
        if self.paused:
            return self.bag_ns
        return self.bag_ns + round((wall - self.wall) * self.rate * 1e9)

    def wall_at(self, bag_ns: int) -> float:
        """Return the wall time at which a bag time is reached; infinite while paused."""
        if self.paused:
            return float("inf")
        return self.wall + (bag_ns - self.bag_ns) * 1e-9 / self.rate

    def pause(self, wall: float) -> Timeline:
        """Return a timeline that is stopped from a wall time on."""
        return replace(self, bag_ns=self.at(wall), wall=wall, paused=True)

    def resume(self, wall: float) -> Timeline:
        """Return a timeline that runs from a wall time on."""
        return replace(self, bag_ns=self.at(wall), wall=wall, paused=False)

    def jump(self, bag_ns: int, wall: float) -> Timeline:
        """Return a timeline that continues at another bag time from a wall time on."""
        return replace(self, bag_ns=bag_ns, wall=wall)
