# SPDX-License-Identifier: Apache-2.0
"""Services and topics that work while the driver's ROS thread is busy: stop, emergency stop, heartbeat."""

import math
import threading
from collections.abc import Callable

from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from worm_driver.control.emergency import EmergencyLatch
from worm_driver.control.hardware import Hardware
from worm_driver.driver_errors import DriverError
from worm_msgs.msg import Heartbeat
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
#: s, longest time until the thread notices that it must end
_PERIOD = 0.5


class StopServices:
    """Second node of the driver's process, with its own executor and thread.

    Args:
        main: node of the driver. The second node has its namespace and remappings.
        opened: returns the hardware. Raises DriverError while none is open.
        emergency: emergency stop, which the topic emergency_stop turns on.
        reject_goals: rejects the goals that have not begun.
        on_heartbeat: called with each heartbeat.
    """

    def __init__(
        self,
        main: Node,
        opened: Callable[[], Hardware],
        emergency: EmergencyLatch,
        reject_goals: Callable[[], None],
        on_heartbeat: Callable[[Heartbeat], None],
    ) -> None:
        self._logger = main.get_logger()
        self._opened = opened
        self._emergency = emergency
        self._reject_goals = reject_goals
        self._demanded = False  # value of the latest message on the emergency stop
        name = f"{main.get_name()}_stop"
        self._node = node = Node(
            name,
            context=main.context,
            namespace=main.get_namespace(),
            cli_args=["--ros-args", "-r", f"__node:={name}"],  # overrides the process's __node:=
            enable_rosout=False,
        )
        node.create_service(Trigger, "stop", self._on_stop, qos_profile=_EVERY_CALL)
        node.create_service(
            Trigger, "reset_emergency_stop", self._on_reset, qos_profile=_EVERY_CALL
        )
        node.create_subscription(Heartbeat, "heartbeat", on_heartbeat, 100)
        for qos in _EMERGENCY_QOS:
            node.create_subscription(Bool, _EMERGENCY, self._on_emergency, qos)
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._serve, name="stop", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread and the node."""
        self._ending.set()
        self._thread.join()
        self._node.destroy_node()

    def _serve(self) -> None:
        executor = SingleThreadedExecutor(context=self._node.context)
        executor.add_node(self._node)
        # After a shutdown of the context, the executor of the main node ends the process.
        while not self._ending.is_set() and self._node.context.ok():
            try:
                executor.spin_once(timeout_sec=_PERIOD)
            except ExternalShutdownException:
                break
            except Exception as error:  # noqa: BLE001 (an error of one request must not end the service of stops)
                self._logger.error(f"a request failed, and has no answer: {error!r}")  # noqa: TRY400
        executor.shutdown()

    def _on_stop(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Stop the robot, whatever commands wait."""
        self._reject_goals()
        try:
            hardware = self._opened()
            message = hardware.loop.run(
                lambda now: hardware.robot.stop(now, "the service stop was called"),
                lifetime=math.inf,
            )
        except Exception as error:  # noqa: BLE001 (the service must survive for the next call)
            response.success, response.message = False, str(error)
        else:
            response.success, response.message = True, message
        return response

    def _on_emergency(self, message: Bool) -> None:
        """Turn the emergency stop on if a message is true: the robot holds. A false message does not turn it off."""
        self._demanded = message.data
        if not message.data:
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
        """Clear the emergency stop, unless the latest message on its topic is true."""
        if self._demanded:
            problem = f"the latest message on {_EMERGENCY} is true: publish false first, then reset"
        else:
            problem = self._emergency.reset() if self._emergency.on else ""
        response.success = not problem
        response.message = problem or "the emergency stop is off: starts are permitted"
        outcome = "not reset" if problem else "reset"
        self._logger.error(f"EMERGENCY STOP {outcome}: {response.message}")
        return response
