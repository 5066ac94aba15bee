# SPDX-License-Identifier: Apache-2.0
"""Second node with its own executor and thread, for requests that must be served while the main node is busy."""

import threading
from collections.abc import Sequence

from rcl_interfaces.msg import SetParametersResult
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter

#: s, longest time until the thread notices that it must end
_PERIOD = 0.5


class SideNode:
    """Node in addition to the main node, with the namespace and the remappings of the main node.

    Attributes:
        node: the node. Create its services and subscriptions before `start`. Its callbacks run in its own thread.
    """

    def __init__(self, main: Node, purpose: str):
        name = f"{main.get_name()}_{purpose}"
        self.node = Node(
            name,
            context=main.context,
            namespace=main.get_namespace(),
            cli_args=["--ros-args", "-r", f"__node:={name}"],  # overrides the process's __node:=
            enable_rosout=False,
        )
        self.node.add_on_set_parameters_callback(self._reject)
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._serve, name=purpose, daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def close(self) -> None:
        """End the thread and the node."""
        self._ending.set()
        self._thread.join()
        self.node.destroy_node()

    def _reject(self, _: Sequence[Parameter]) -> SetParametersResult:
        """Reject every parameter, also use_sim_time, because no parameter would have an effect."""
        reason = f"{self.node.get_name()} has no parameters of its own: set those of the main node"
        return SetParametersResult(successful=False, reason=reason)

    def _serve(self) -> None:
        executor = SingleThreadedExecutor(context=self.node.context)
        executor.add_node(self.node)
        try:
            # After a shutdown of the context, the executor of the main node ends the process.
            while not self._ending.is_set() and self.node.context.ok():
                self._serve_once(executor)
        finally:
            executor.shutdown()

    def _serve_once(self, executor: SingleThreadedExecutor) -> None:
        """Serve one request, if one arrives. An error in its callback must not end the service of stops."""
        try:
            executor.spin_once(timeout_sec=_PERIOD)
        except ExternalShutdownException:
            return
        except Exception as error:  # noqa: BLE001 - any error of any callback
            self.node.get_logger().error(f"a request failed, and has no answer: {error!r}")
