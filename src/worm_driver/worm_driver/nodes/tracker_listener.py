# SPDX-License-Identifier: Apache-2.0
"""What the driver knows from the tracker: whether there is one, whether the robot stands, and where it is."""

import math
import time
from collections.abc import Callable

from rclpy.node import Node

from worm_driver.gait.stillness import Stillness
from worm_driver.nodes.stamps import Stamps
from worm_msgs.msg import Tracker

#: s, how old the latest sample may be when a gait starts, and how long the first one may take (discovery: up to 3 s)
_FRESH = 0.2
_DISCOVERY = 5.0


class TrackerListener:
    """Listens to ``tracker``; everything happens in the node's executor thread.

    ``tell`` gets every sample: s monotonic, and the rear module's position in m, NaN while it is hidden.
    """

    def __init__(self, node: Node, stamps: Stamps, tell: Callable[[float, float], None]) -> None:
        self._stamps = stamps
        self._tell = tell
        self._born = time.monotonic()
        self._heard = -math.inf
        self._stillness = Stillness()
        node.create_subscription(Tracker, "tracker", self._on_sample, 100)

    def forget(self) -> None:
        """Another robot's clock may come."""
        self._heard = -math.inf

    def is_ready(self) -> bool:
        """Whether the robot is seen to stand, or so long was not that there is no tracker."""
        if math.isinf(self._heard):
            return time.monotonic() - self._born > _DISCOVERY
        return self.sees_robot() and self._stillness.lasts

    def sees_robot(self) -> bool:
        """Whether samples come in."""
        return self._stamps.monotonic() - self._heard < _FRESH

    def _on_sample(self, message: Tracker) -> None:
        now = self._heard = self._stamps.monotonic()
        self._stillness.observe(now, message.rear_position, message.front_position)
        self._tell(self._stamps.clocks().monotonic(message.header.stamp), message.rear_position)
