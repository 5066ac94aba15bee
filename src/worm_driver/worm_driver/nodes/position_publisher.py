# SPDX-License-Identifier: Apache-2.0
"""Publisher of the measurements of a camera: the topics ``tracker`` and ``body_length/measured``."""

import math

from builtin_interfaces.msg import Time
from rclpy.node import Node
from std_msgs.msg import Header

from worm_msgs.msg import BodyLength, Tracker

FRAME = "pipe"  # x forward along the axis, z up (REP 103)
_SAMPLES = 30  # number of first lengths, assumed to be at rest; their mean is the zero of the length changes


class PositionPublisher:
    """Publisher of positions and length. ``depth`` samples may wait for a slow subscriber."""

    def __init__(self, node: Node, depth: int) -> None:
        self._positions = node.create_publisher(Tracker, "tracker", depth)
        self._length = node.create_publisher(BodyLength, "body_length/measured", depth)
        self._sum, self._count = 0.0, 0

    def publish(self, stamp: Time, rear: float, front: float) -> None:
        """Publish the positions (m) of the modules, NaN while one is hidden, and the length if both are visible."""
        header = Header(stamp=stamp, frame_id=FRAME)
        self._positions.publish(Tracker(header=header, rear_position=rear, front_position=front))
        length = front - rear
        if math.isnan(length):
            return
        if self._count < _SAMPLES:
            self._sum += length
            self._count += 1
        change = length - self._sum / self._count
        source = BodyLength.MEASURED
        self._length.publish(
            BodyLength(header=header, source=source, length=length, length_change=change)
        )
