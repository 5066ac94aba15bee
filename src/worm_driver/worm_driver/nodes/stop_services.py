# SPDX-License-Identifier: Apache-2.0
"""What must be heard while the driver's own thread is busy: ``stop``, ``emergency_stop`` and the heartbeat."""

import math
from collections.abc import Callable, Iterator

from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from worm_driver.control.emergency import EmergencyLatch
from worm_driver.control.hardware import Hardware
from worm_driver.errors import DriverError
from worm_driver.nodes.side_node import SideNode
from worm_msgs.msg import Heartbeat
from worm_msgs.qos import LATCHED

#: no request is dropped, however many wait: whoever calls stop gets an answer
_EVERY_CALL = QoSProfile(history=HistoryPolicy.KEEP_ALL)
#: what is said once is not lost, even where the publisher has found the driver, but not yet the driver the publisher
_ONCE = QoSProfile(depth=10)
#: matches every publisher, also one that promises nothing
_ANYBODY = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)


class StopServices:
    """Served by a node beside the driver's, in its own thread; ``opened`` raises DriverError while nothing is open."""

    def __init__(
        self,
        node: Node,
        opened: Callable[[], Hardware],
        emergency: EmergencyLatch,
        on_heartbeat: Callable[[Heartbeat], None],
    ) -> None:
        self._logger = node.get_logger()
        self._opened = opened
        self._emergency = emergency
        self._side = SideNode(node, "stop")
        side = self._side.node
        self._stop = side.create_service(Trigger, "stop", self._on_stop, qos_profile=_EVERY_CALL)
        side.create_subscription(Heartbeat, "heartbeat", on_heartbeat, 100)
        # Also what was said before this driver began, which may be a stop but takes none back; from anybody.
        side.create_subscription(Bool, "emergency_stop", self._on_kept_emergency, LATCHED)
        side.create_subscription(Bool, "emergency_stop", self._on_emergency, _ONCE)
        side.create_subscription(Bool, "emergency_stop", self._on_emergency, _ANYBODY)
        self._side.start()

    def close(self) -> None:
        """Ends the node and its thread."""
        self._side.close()

    def _on_stop(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """One stop answers all who have called by then, as it takes a cycle."""
        others = list(self._further_stops())
        try:
            hardware = self._opened()
            hardware.loop.insist(
                lambda now: hardware.robot.stop(now, "the service stop was called")
            )
        except Exception as error:  # noqa: BLE001 (the next call must find the service alive)
            response.success, response.message = False, str(error)
        else:
            response.success, response.message = True, "stopped, and holding"
        for header in others:
            self._stop.send_response(response, header)
        return response

    def _further_stops(self) -> Iterator[object]:
        """The headers of calls that wait behind the one that is being served."""
        handle = self._stop.handle
        with handle:
            while (header := handle.service_take_request(Trigger.Request)[1]) is not None:
                yield header

    def _on_kept_emergency(self, word: Bool) -> None:
        if word.data:
            self._on_emergency(word)

    def _on_emergency(self, word: Bool) -> None:
        """Nothing starts from here on, and what moves holds."""
        if word.data != self._emergency.on:
            problem = self._emergency.set(word.data)
            self._logger.error(
                f"EMERGENCY STOP {'on: nothing starts' if word.data else 'off'}. {problem}".strip()
            )
        if not word.data:
            return
        try:
            hardware = self._opened()
        except DriverError:
            return  # nothing is open that could move
        hardware.loop.submit(
            lambda now: hardware.robot.stop(now, "the emergency stop is on"), patience=math.inf
        )
