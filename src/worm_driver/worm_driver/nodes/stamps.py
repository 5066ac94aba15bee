# SPDX-License-Identifier: Apache-2.0
"""ROS stamps of the driver's messages: from the ROS clock, or from the robot's own clock for a virtual robot."""

import time

from builtin_interfaces.msg import Time
from rclpy.node import Node

from worm_driver.clock import Clock
from worm_driver.nodes.driver_messages import ClockPair


class Stamps:
    """Source of a node's stamps.

    Attributes:
        robot_clock: clock of the robot that was configured last; None before. A clean-up does not reset it, so that
            later stamps continue the earlier ones.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._clocks: ClockPair | None = None
        self.robot_clock: Clock | None = None

    def clocks(self) -> ClockPair:
        """Return the difference between the ROS clock and the robot's clock. Log a step of the ROS clock, as by NTP.

        A real robot uses the monotonic clock. So a step of the ROS clock changes the stamps, but neither motion nor
        metrics.
        """
        clock = self.robot_clock
        if clock is not None and clock.epoch_ns is not None:
            return ClockPair(clock.epoch_ns)  # The ROS time of a virtual robot is its own clock.
        clocks = ClockPair.read(lambda: self._node.get_clock().now().nanoseconds)
        step = 0.0 if self._clocks is None else clocks.step_since(self._clocks)
        if step:
            self._node.get_logger().warning(
                f"the system clock has jumped by {step:.3f} s, and the stamps with it"
            )
        self._clocks = clocks
        return clocks

    def now(self) -> Time:
        """Return the present stamp."""
        clock = self.robot_clock
        if clock is not None and clock.epoch_ns is not None:
            return ClockPair(clock.epoch_ns).stamp(clock())
        stamp: Time = self._node.get_clock().now().to_msg()
        return stamp

    def monotonic(self) -> float:
        """Return the robot's present time, s."""
        return time.monotonic() if self.robot_clock is None else self.robot_clock()
