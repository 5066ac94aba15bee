# SPDX-License-Identifier: Apache-2.0
"""Node for use in a single thread. Its service calls and waits have timeouts and spin the node."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import rclpy
from rclpy.client import Client
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

DISCOVERY_TIMEOUT_S = 30.0  # timeout for the discovery of a service, action or topic, s
CALL_TIMEOUT_S = 30.0  # timeout for the answer to a request, s
SPIN_S = 0.05  # longest wait for a callback between two calls of ``check``, s


class OperatorError(RuntimeError):
    """A node did not answer in time, or rejected a request."""


class NoAnswerError(OperatorError):
    """No answer arrived in time."""


class ServiceCaller(Node):
    """Node with its own executor. Service calls and waits block, and spin the node meanwhile.

    Args:
        name: name of the node.
        namespace: namespace of the node.
        context: ROS context.
        check: called repeatedly during each wait. It may raise, for example when a process has ended.
    """

    def __init__(
        self, name: str, namespace: str, context: rclpy.Context, check: Callable[[], None]
    ) -> None:
        super().__init__(name, namespace=namespace, context=context)
        self._check = check
        self._named_clients: dict[str, Client] = {}
        self._executor = SingleThreadedExecutor(context=context)
        self._executor.add_node(self)

    def destroy_node(self) -> None:
        """Destroy the node and its executor."""
        self._executor.shutdown()
        super().destroy_node()

    def wait(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        """Spin until a condition holds; return False at the timeout (s)."""
        deadline = time.monotonic() + timeout_s
        while not condition():
            if time.monotonic() > deadline:
                return False
            self.spin()
        return True

    def spin(self) -> None:
        """Call ``check``, then wait up to `SPIN_S` for a callback and execute it."""
        self._check()
        self._executor.spin_once(timeout_sec=SPIN_S)

    def named_client(self, kind: Any, name: str) -> Client:
        """Return the client of a service. All calls share this client, because a new one has to be discovered first."""
        if name not in self._named_clients:
            self._named_clients[name] = self.create_client(kind, name)
        return self._named_clients[name]

    def call(self, kind: Any, name: str, request: Any) -> Any:
        """Call a service and return its response. Raises `OperatorError` if no server or no answer appears in time."""
        client = self.named_client(kind, name)
        if not self.wait(client.service_is_ready, DISCOVERY_TIMEOUT_S):
            raise OperatorError(f"no service {name} within {DISCOVERY_TIMEOUT_S:g} s")
        future = client.call_async(request)
        if not self.wait(future.done, CALL_TIMEOUT_S):
            raise NoAnswerError(f"no answer from {name} within {CALL_TIMEOUT_S:g} s")
        return future.result()

    def call_twice(self, kind: Any, name: str, request: Any) -> Any:
        """Like `call`, but repeat the call once if no answer arrives. On a busy computer, an answer can get lost."""
        try:
            return self.call(kind, name, request)
        except NoAnswerError:
            return self.call(kind, name, request)
