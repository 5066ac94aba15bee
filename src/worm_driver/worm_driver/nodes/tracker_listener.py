# SPDX-License-Identifier: Apache-2.0
"""Subscription of the driver to the tracker."""

import math
import time
from collections.abc import Callable

from rclpy.node import Node

from worm_driver.gait.stillness import Stillness
from worm_driver.nodes.driver_messages import Stamps
from worm_msgs.msg import Tracker

#: s, age up to which the latest sample counts as recent; a busy computer delays samples
_FRESH = 1.0
#: s, time without any sample after which the driver assumes that there is no tracker; discovery takes up to 3 s
_DISCOVERY = 5.0
#: m, a marker farther from the origin counts as hidden, because no pipe is so long
_FARTHEST = 1e4


class TrackerListener:
    """Subscriber to ``tracker``, in the node's executor thread.

    ``on_position`` is called with the time (s, monotonic) and the position of the rear module (m, NaN while hidden).
    """

    def __init__(
        self, node: Node, stamps: Stamps, on_position: Callable[[float, float], None]
    ) -> None:
        self._stamps = stamps
        self._on_position = on_position
        self._created = time.monotonic()
        self._last_received = -math.inf
        self._stillness = Stillness()
        node.create_subscription(Tracker, "tracker", self._on_sample, 100)

    def forget(self) -> None:
        """Forget the time of the latest sample, because the next robot to be configured may have another clock."""
        self._last_received = -math.inf

    def is_ready(self) -> bool:
        """Return True if the tracker has seen the robot at rest, or if there is no tracker."""
        if math.isinf(self._last_received):
            return time.monotonic() - self._created > _DISCOVERY
        return self.is_publishing() and self._stillness.lasts

    def is_publishing(self) -> bool:
        """Return True if the tracker publishes, whether or not the markers are visible."""
        return self._stamps.monotonic() - self._last_received < _FRESH

    def _on_sample(self, message: Tracker) -> None:
        now = self._last_received = self._stamps.monotonic()
        rear, front = (
            position if abs(position) <= _FARTHEST else math.nan
            for position in (message.rear_position, message.front_position)
        )
        self._stillness.observe(now, rear, front)
        self._on_position(self._stamps.clocks().monotonic(message.header.stamp), rear)
