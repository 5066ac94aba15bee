# SPDX-License-Identifier: Apache-2.0
"""Node for use in a single thread. Its service calls and waits have timeouts and spin the node."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from typing import Any

import rclpy
from rclpy.client import Client
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from worm_model.bags.worm_topics import IMAGES
from worm_msgs.claim import ANNOUNCED_S, DRIVER_SERVICE

DISCOVERY_TIMEOUT_S = 30.0  # timeout for the discovery of a service, action or topic, s
CALL_TIMEOUT_S = 30.0  # timeout for the answer to a request, s
SPIN_S = 0.05  # longest wait for a callback between two calls of ``check``, s
# Timeout of `wait_for_nodes`, s. At its first start, the twin compiles its kernel.
NODES_TIMEOUT_S = 120.0


class OperatorError(RuntimeError):
    """A node did not answer in time, or rejected a request."""


class RobotClient(Node):
    """Client of the nodes in one namespace, with its own executor. Calls and waits block, and spin the node meanwhile.

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

    # --- services ------------------------------------------------------------------------------

    def named_client(self, kind: Any, name: str) -> Client:
        """Return the client of a service. All calls share this client, because a new one has to be discovered first."""
        if name not in self._named_clients:
            self._named_clients[name] = self.create_client(kind, name)
        return self._named_clients[name]

    def call(self, kind: Any, name: str, request: Any, attempts: int = 2) -> Any:
        """Call a service and return its response. On a busy computer an answer can get lost, so the call is repeated.

        Args:
            kind: type of the service.
            name: name of the service.
            request: the request.
            attempts: largest number of calls; 1 for a request that must not be executed twice.
        """
        client = self.named_client(kind, name)
        if not self.wait(client.service_is_ready, DISCOVERY_TIMEOUT_S):
            raise OperatorError(f"no service {name} within {DISCOVERY_TIMEOUT_S:g} s")
        for _ in range(attempts):
            future = client.call_async(request)
            if self.wait(future.done, CALL_TIMEOUT_S):
                return future.result()
        raise OperatorError(f"no answer from {name} within {CALL_TIMEOUT_S:g} s")

    # --- the ROS graph -------------------------------------------------------------------------

    def wait_for_nodes(self, names: Iterable[str]) -> None:
        """Wait until nodes exist in this namespace. Raises `OperatorError`, with the name of a missing node."""
        expected, own = set(names), self.get_namespace()

        def missing() -> set[str]:
            found = self.get_node_names_and_namespaces()
            return expected - {name for name, namespace in found if namespace == own}

        if not self.wait(lambda: not missing(), NODES_TIMEOUT_S):
            raise OperatorError(f"no node {min(missing())} within {NODES_TIMEOUT_S:g} s")

    def require_sole_driver(self) -> None:
        """Raise `OperatorError` if several drivers would execute a command.

        A request reaches all servers of a service. This method counts the drivers by their service `DRIVER_SERVICE`.
        The node discovers a driver's end late if its process was killed. The method therefore waits up to
        `ANNOUNCED_S` until it counts at most one driver.
        """
        if not self.wait(lambda: self.count_services(DRIVER_SERVICE) <= 1, ANNOUNCED_S):
            raise OperatorError(
                f"{self.get_namespace()} has {self.count_services(DRIVER_SERVICE)} drivers, and all of them would "
                "move: end all but one, or give each its own namespace or ROS_DOMAIN_ID"
            )

    def wait_for_recorder(self, name: str) -> None:
        """Wait until a recorder has subscribed to all topics of this namespace that it records.

        These are the visible ones with publishers, without images. Without this wait, the recording would
        lack the first messages.

        Raises:
            OperatorError: The recorder, with the name ``name``, did not subscribe in time to a topic in the message.
        """
        prefix = f"{self.get_namespace().rstrip('/')}/"

        def missing() -> list[str]:
            return [
                topic
                for topic, types in self.get_topic_names_and_types()
                if topic.startswith(prefix)
                and IMAGES.isdisjoint(types)
                and "/_" not in topic
                and self.count_publishers(topic) > 0
                and name not in [i.node_name for i in self.get_subscriptions_info_by_topic(topic)]
            ]

        if not self.wait(lambda: not missing(), DISCOVERY_TIMEOUT_S) and (topics := missing()):
            raise OperatorError(f"{name} does not subscribe to {topics[0]}")
