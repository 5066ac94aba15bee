# SPDX-License-Identifier: Apache-2.0
"""The ROS times of what the driver tells: by the robot's own clock where it has one, else by the computer's."""

import time

from builtin_interfaces.msg import Time
from rclpy.node import Node

from worm_driver.clock import Clock
from worm_driver.nodes.driver_messages import ClockPair


class Stamps:
    """Times of a node.

    Attributes:
        robot_clock: that of the robot which was opened last; it stays after a clean-up, so that stamps go on.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._clocks: ClockPair | None = None
        self.robot_clock: Clock | None = None

    def clocks(self) -> ClockPair:
        """Both clocks now; a step of the ROS clock (NTP, a Pi without a clock of its own) is told.

        The robot goes by the monotonic clock: stamps jump with the ROS clock, motion and figures do not.
        """
        clock = self.robot_clock
        if clock is not None and clock.epoch_ns is not None:
            return ClockPair(clock.epoch_ns)  # a virtual robot's, which is both
        clocks = ClockPair.read(lambda: self._node.get_clock().now().nanoseconds)
        step = 0.0 if self._clocks is None else clocks.step_since(self._clocks)
        if step:
            self._node.get_logger().warning(
                f"the clock was set by {step:.3f} s: stamps jump by as much"
            )
        self._clocks = clocks
        return clocks

    def now(self) -> Time:
        """The stamp of what is told now."""
        clock = self.robot_clock
        if clock is not None and clock.epoch_ns is not None:
            return ClockPair(clock.epoch_ns).stamp(clock())
        stamp: Time = self._node.get_clock().now().to_msg()
        return stamp

    def monotonic(self) -> float:
        """The robot's time now, s."""
        return time.monotonic() if self.robot_clock is None else self.robot_clock()
