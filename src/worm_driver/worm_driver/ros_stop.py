# SPDX-License-Identifier: Apache-2.0
"""The service stop, on a node and in a thread of its own: served also while a transition keeps the driver busy."""

import threading
from collections.abc import Callable

from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

#: s, in which the thread notices that it is to end
_PATIENCE = 0.1


class StopService:
    """Serves stop under the driver's name for it, until it is closed.

    Args:
        driver: the node beside which it is served.
        stop: stops the robot; called in the service's thread. What it raises is the service's answer.
    """

    def __init__(self, driver: Node, stop: Callable[[], None]):
        self._stop = stop
        self._node = Node(
            f"{driver.get_name()}_stop",
            context=driver.context,
            namespace=driver.get_namespace(),
            use_global_arguments=False,  # __node:= would give both nodes one name
            enable_rosout=False,
            start_parameter_services=False,
            parameter_overrides=[Parameter("start_type_description_service", value=False)],
        )
        self._node.create_service(Trigger, driver.resolve_service_name("stop"), self._answer)
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._serve, name="stop", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Ends the thread and the node."""
        self._ending.set()
        self._thread.join()
        self._node.destroy_node()

    def _serve(self) -> None:
        executor = SingleThreadedExecutor(context=self._node.context)
        executor.add_node(self._node)
        try:
            while not self._ending.is_set():
                executor.spin_once(timeout_sec=_PATIENCE)
        except ExternalShutdownException:
            return  # the driver's own executor tells of it
        finally:
            executor.shutdown()

    def _answer(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        try:
            self._stop()
        except Exception as error:  # noqa: BLE001 (the next call must find the service alive)
            response.success, response.message = False, str(error)
        else:
            response.success, response.message = True, "stopped, and holding"
        return response
