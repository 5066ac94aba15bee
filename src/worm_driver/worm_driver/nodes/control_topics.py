# SPDX-License-Identifier: Apache-2.0
"""The topics of the control lease: requests of clients, and the holder."""

import time
from collections.abc import Callable

from builtin_interfaces.msg import Time
from rclpy.clock import Clock as RosClock
from rclpy.clock import ClockType
from rclpy.node import Node

from worm_driver.control.control_lease import ControlLease
from worm_driver.control.heartbeat import PERIOD
from worm_msgs.msg import ControlRequest, ControlState
from worm_msgs.qos import LATCHED


class ControlTopics:
    """Serves the control lease on a node, in the node's executor thread.

    Args:
        node: node of the subscription, the publisher and the timer.
        stamp: returns the present ROS time.
    """

    def __init__(self, node: Node, stamp: Callable[[], Time]) -> None:
        self._lease = ControlLease()
        self._logger = node.get_logger()
        self._stamp = stamp
        self._published: tuple[str, str] | None = None
        self._state = node.create_publisher(ControlState, "control", LATCHED)
        node.create_subscription(ControlRequest, "control/request", self._on_request, 100)
        # Runs only while a client has control, because each wake-up delays the servo thread.
        self._timer = node.create_timer(
            PERIOD, self._expire, clock=RosClock(clock_type=ClockType.STEADY_TIME)
        )
        self._publish()

    def _on_request(self, message: ControlRequest) -> None:
        if message.wish == ControlRequest.CONTROL:
            self._on_control(message)
        elif message.wish == ControlRequest.HAND_OVER:
            self._lease.hand_over(message.client)
        elif message.wish == ControlRequest.RELEASE:
            self._lease.release(message.client)
        self._publish()

    def _on_control(self, message: ControlRequest) -> None:
        try:
            self._lease.request(message.client, message.lease_s, time.monotonic())
        except ValueError as error:
            self._logger.warning(f"control/request of {message.client} is ignored: {error}")

    def _expire(self) -> None:
        self._lease.expire(time.monotonic())
        self._publish()

    def _publish(self) -> None:
        state = (self._lease.holder, self._lease.requester)
        if state == self._published:
            return
        self._published = state
        message = ControlState(holder=state[0], requester=state[1])
        message.header.stamp = self._stamp()
        self._state.publish(message)
        if not self._lease.holder:
            self._timer.cancel()
        elif self._timer.is_canceled():
            self._timer.reset()
