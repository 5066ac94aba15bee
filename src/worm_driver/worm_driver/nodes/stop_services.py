# SPDX-License-Identifier: Apache-2.0
"""Services and topics that work while the driver's ROS thread is busy: stop, emergency stop, heartbeat, control."""

import math
import time
from collections.abc import Callable, Iterator

from builtin_interfaces.msg import Time
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from std_srvs.srv import Trigger

from worm_driver.control.control_lease import ControlLease
from worm_driver.control.emergency import EmergencyLatch, StopPublishers
from worm_driver.control.hardware import Hardware
from worm_driver.control.heartbeat import PERIOD
from worm_driver.errors import DriverError
from worm_driver.nodes.identified_subscription import IdentifiedSubscription
from worm_driver.nodes.side_node import SideNode
from worm_msgs.msg import ControlRequest, ControlState, Heartbeat
from worm_msgs.qos import LATCHED

#: The middleware drops no request, so every call of stop gets a response.
_EVERY_CALL = QoSProfile(history=HistoryPolicy.KEEP_ALL)
#: Subscriptions to the emergency stop: a latched one for messages from before the start of the driver, a reliable one
#: for publishers that are not latched, and one for publishers with best effort.
_EMERGENCY_QOS = (
    LATCHED,
    QoSProfile(depth=10),
    QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT),
)
_EMERGENCY = "emergency_stop"


class StopServices:
    """Services of a second node of the driver's process, in its own thread.

    Args:
        node: node of the driver.
        opened: returns the hardware. Raises DriverError while none is open.
        emergency: emergency stop, which the topic emergency_stop turns on.
        reject_goals: rejects the goals that have not begun.
        on_heartbeat: called with each heartbeat.
        stamp: returns the present ROS time.
    """

    def __init__(
        self,
        node: Node,
        opened: Callable[[], Hardware],
        emergency: EmergencyLatch,
        reject_goals: Callable[[], None],
        on_heartbeat: Callable[[Heartbeat], None],
        stamp: Callable[[], Time],
    ) -> None:
        self._logger = node.get_logger()
        self._opened = opened
        self._emergency = emergency
        self._reject_goals = reject_goals
        self._side = SideNode(node, "stop")
        side = self._side.node
        self._stop = side.create_service(Trigger, "stop", self._on_stop, qos_profile=_EVERY_CALL)
        side.create_service(
            Trigger, "reset_emergency_stop", self._on_reset, qos_profile=_EVERY_CALL
        )
        side.create_subscription(Heartbeat, "heartbeat", on_heartbeat, 100)
        _ControlTopics(side, stamp)
        self._publishers = StopPublishers()
        self._emergencies = [
            IdentifiedSubscription(side, _EMERGENCY, qos, self._on_emergency)
            for qos in _EMERGENCY_QOS
        ]
        self._side.start()

    def close(self) -> None:
        """End the node and its thread."""
        self._side.close()

    def _on_stop(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Stop the robot. One stop, which takes a control cycle, answers all waiting calls."""
        others = list(self._further_stops())
        self._reject_goals()
        try:
            hardware = self._opened()
            message = hardware.loop.run_without_deadline(
                lambda now: hardware.robot.stop(now, "the service stop was called")
            )
        except Exception as error:  # noqa: BLE001 (the service must survive for the next call)
            response.success, response.message = False, str(error)
        else:
            response.success, response.message = True, message
        for header in others:
            self._stop.send_response(response, header)
        return response

    def _further_stops(self) -> Iterator[object]:
        """Yield the headers of the calls that wait behind the present one."""
        handle = self._stop.handle
        with handle:
            while (header := handle.service_take_request(Trigger.Request)[1]) is not None:
                yield header

    def _present(self) -> dict[bytes, str]:
        """Return the present publishers of the emergency stop: identifier and name of the node."""
        return {
            bytes(info.endpoint_gid): f"{info.node_namespace.rstrip('/')}/{info.node_name}"
            for info in self._side.node.get_publishers_info_by_topic(_EMERGENCY)
        }

    def _on_emergency(self, publisher: bytes, sent_ns: int, stops: bool) -> None:  # noqa: FBT001
        """Turn the emergency stop on if a message is true: the robot holds. A false message does not turn it off."""
        try:
            present = self._present()
        except Exception as error:  # noqa: BLE001 (the stop must not depend on the graph)
            present = {}
            self._logger.error(f"unknown publishers of {_EMERGENCY}: {error!r}")  # noqa: TRY400
        if not self._publishers.note(publisher, sent_ns, stops, present) or not stops:
            return
        self._reject_goals()
        if not self._emergency.on:
            problem = self._emergency.latch()
            self._logger.error(f"EMERGENCY STOP on: nothing starts. {problem}".strip())
        try:
            hardware = self._opened()
        except DriverError:
            return  # No robot is open that could move.
        hardware.loop.submit(
            lambda now: hardware.robot.stop(now, "the emergency stop is on"), lifetime=math.inf
        )

    def _on_reset(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Clear the emergency stop, unless the last message of a present publisher is true."""
        for subscription in self._emergencies:  # Process messages that arrived before the request.
            subscription.drain()
        present = self._present()
        stopping = self._publishers.stopping(present)
        if stopping:
            nodes = sorted({present.get(publisher, "an unknown node") for publisher in stopping})
            last = f"the last message of {', '.join(nodes)} on {_EMERGENCY} is true"
            response.success = False
            response.message = f"{last}: publish false from there first, then reset"
            return response
        gone = self._publishers.forget_absent(present)
        problem = self._emergency.reset() if self._emergency.on else ""
        response.success = not problem
        response.message = problem or "the emergency stop is off: starts are permitted"
        if gone and not problem:
            response.message += f" ({gone} of its publishers ended without publishing false)"
        outcome = "not reset" if problem else "reset"
        self._logger.error(f"EMERGENCY STOP {outcome}: {response.message}")
        return response


class _ControlTopics:
    """Topics of the control lease: requests of clients, and the present holder. Runs in the node's executor thread.

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
            PERIOD, self._expire, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )
        self._publish()

    def _on_request(self, message: ControlRequest) -> None:
        if message.wish == ControlRequest.CONTROL:
            self._on_control(message)
        elif message.wish == ControlRequest.HAND_OVER:
            self._lease.hand_over(message.client)
        elif message.wish == ControlRequest.RELEASE:
            self._lease.release(message.client)
        else:
            text = f"control/request of {message.client} is ignored: wish is {message.wish}"
            self._logger.warning(text)
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
