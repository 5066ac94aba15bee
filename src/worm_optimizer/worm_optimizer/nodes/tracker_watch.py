# SPDX-License-Identifier: Apache-2.0
"""Monitor that reports the loss and the return of the tracker's measurements."""

from __future__ import annotations

import math
from collections.abc import Callable

from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from worm_msgs.msg import Tracker

# Time without a position, in s of the robot's clock, after which the tracker counts as lost. Markers are often hidden
# for a moment.
SILENCE_S = 2.0
LOOK_S = 0.25  # period of the checks, s


class TrackerWatch:
    """Monitor of the tracker, which runs in the callbacks of a node and ends with the node.

    Args:
        node: node in the robot's namespace.
        now: returns the robot's time (s). The time of a virtual robot stops while it waits for a busy computer.
        say: called with the text of each report, which is one line long.
    """

    def __init__(self, node: Node, now: Callable[[], float], say: Callable[[str], None]) -> None:
        self._now, self._say = now, say
        self._received_at = self._seen_at = now()
        self._lost = False
        node.create_subscription(Tracker, "tracker", self._receive, 10)
        node.create_timer(LOOK_S, self._look, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _receive(self, message: Tracker) -> None:
        self._received_at = self._now()
        if math.isfinite(message.rear_position) and math.isfinite(message.front_position):
            if self._lost:
                self._say(f"the tracker is back after {self._received_at - self._seen_at:.1f} s")
            self._seen_at, self._lost = self._received_at, False

    def _look(self) -> None:
        now = self._now()
        if self._lost or now - self._seen_at < SILENCE_S:
            return
        self._lost = True
        what = (
            "no message of the tracker"
            if now - self._received_at >= SILENCE_S
            else "the tracker does not see both modules"
        )
        self._say(f"{what} for {SILENCE_S:g} s: no speed can be measured until it is back")
