# SPDX-License-Identifier: Apache-2.0
"""A second node with an executor and a thread of its own, for what must be served while the first one is busy."""

import threading
from collections.abc import Sequence

from rcl_interfaces.msg import SetParametersResult
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter

#: s, in which the thread notices that it is to end
_PATIENCE = 0.5


class SideNode:
    """A bare node beside another one, in its namespace and under the same remappings.

    Attributes:
        node: to be furnished before the start; its callbacks run in its own thread.
    """

    def __init__(self, main: Node, purpose: str):
        name = f"{main.get_name()}_{purpose}"
        self.node = Node(
            name,
            context=main.context,
            namespace=main.get_namespace(),
            cli_args=["--ros-args", "-r", f"__node:={name}"],  # before the process's own __node:=
            enable_rosout=False,
        )
        self.node.add_on_set_parameters_callback(self._reject)
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._serve, name=purpose, daemon=True)

    def start(self) -> None:
        """Starts the thread."""
        self._thread.start()

    def close(self) -> None:
        """Ends the thread and the node."""
        self._ending.set()
        self._thread.join()
        self.node.destroy_node()

    def _reject(self, _: Sequence[Parameter]) -> SetParametersResult:
        """Reject every parameter, use_sim_time included, as none would have an effect here."""
        reason = f"{self.node.get_name()} has no parameters of its own: set those of the main node"
        return SetParametersResult(successful=False, reason=reason)

    def _serve(self) -> None:
        executor = SingleThreadedExecutor(context=self.node.context)
        executor.add_node(self.node)
        try:
            while not self._ending.is_set():
                executor.spin_once(timeout_sec=_PATIENCE)
        except ExternalShutdownException:
            return  # the main node's own executor tells of it
        finally:
            executor.shutdown()
