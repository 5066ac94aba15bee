# SPDX-License-Identifier: Apache-2.0
"""Tells of a tracker that falls silent or sees nothing while a robot is worked with, and of its return."""

from __future__ import annotations

import math
from collections.abc import Callable

from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from worm_msgs.msg import Tracker

# of the robot's time without a position; a marker that is covered for a moment is usual
SILENCE_S = 2.0
LOOK_S = 0.25


class TrackerWatch:
    """Owned by whoever spins the node, until the node is destroyed.

    Args:
        node: that listens, in the robot's namespace.
        now: the robot's time (s), so that a virtual robot that waits for a busy computer is not taken for blind.
        say: takes one line.
    """

    def __init__(self, node: Node, now: Callable[[], float], say: Callable[[str], None]) -> None:
        self._now, self._say = now, say
        self._heard_at = self._seen_at = now()
        self._lost = False
        node.create_subscription(Tracker, "tracker", self._hear, 10)
        node.create_timer(LOOK_S, self._look, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _hear(self, message: Tracker) -> None:
        self._heard_at = self._now()
        if math.isfinite(message.rear_position) and math.isfinite(message.front_position):
            if self._lost:
                self._say(f"the tracker is back after {self._heard_at - self._seen_at:.1f} s")
            self._seen_at, self._lost = self._heard_at, False

    def _look(self) -> None:
        now = self._now()
        if self._lost or now - self._seen_at < SILENCE_S:
            return
        self._lost = True
        what = (
            "nothing is heard of the tracker"
            if now - self._heard_at >= SILENCE_S
            else "the tracker does not see both modules"
        )
        self._say(f"{what} for {SILENCE_S:g} s: no speed can be measured meanwhile")
