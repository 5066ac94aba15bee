# SPDX-License-Identifier: Apache-2.0
"""Subscription of the driver to the tracker."""

import math
import time
from collections.abc import Callable

from rclpy.node import Node

from worm_driver.gait.stillness import Stillness
from worm_driver.nodes.stamps import Stamps
from worm_msgs.msg import Tracker

#: s, largest age of the latest sample at the start of a gait, and timeout of the first sample (discovery takes 3 s)
_FRESH = 0.2
_DISCOVERY = 5.0


class TrackerListener:
    """Subscriber to ``tracker``, in the node's executor thread.

    ``on_sample`` is called with the time (s, monotonic) and the position of the rear module (m, NaN while hidden).
    """

    def __init__(
        self, node: Node, stamps: Stamps, on_sample: Callable[[float, float], None]
    ) -> None:
        self._stamps = stamps
        self._on_position = on_sample
        self._created = time.monotonic()
        self._last_received = -math.inf
        self._stillness = Stillness()
        node.create_subscription(Tracker, "tracker", self._on_sample, 100)

    def forget(self) -> None:
        """Forget the time of the latest sample, as the next robot may have another clock."""
        self._last_received = -math.inf

    def is_ready(self) -> bool:
        """Return True if the tracker sees the robot at rest, or if no sample has arrived within the timeout."""
        if math.isinf(self._last_received):
            return time.monotonic() - self._created > _DISCOVERY
        return self.sees_robot() and self._stillness.lasts

    def sees_robot(self) -> bool:
        """Return True if the latest sample is recent."""
        return self._stamps.monotonic() - self._last_received < _FRESH

    def _on_sample(self, message: Tracker) -> None:
        now = self._last_received = self._stamps.monotonic()
        self._stillness.observe(now, message.rear_position, message.front_position)
        self._on_position(
            self._stamps.clocks().monotonic(message.header.stamp), message.rear_position
        )
