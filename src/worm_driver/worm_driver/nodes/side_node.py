# SPDX-License-Identifier: Apache-2.0
"""A second node with an executor and a thread of its own, for what must be served while the first one is busy."""

import threading

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
            start_parameter_services=False,
            parameter_overrides=[Parameter("start_type_description_service", value=False)],
        )
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
