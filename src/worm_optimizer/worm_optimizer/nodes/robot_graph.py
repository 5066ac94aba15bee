# SPDX-License-Identifier: Apache-2.0
"""Part of the ROS graph that belongs to one robot: nodes, publishers, subscribers and drivers."""

from __future__ import annotations

from collections.abc import Iterable

from worm_model.bags.worm_topics import IMAGES
from worm_msgs.claim import ANNOUNCED_S, DRIVER_SERVICE
from worm_optimizer.nodes.service_caller import DISCOVERY_TIMEOUT_S, OperatorError, ServiceCaller

# Timeout of `wait_for_nodes`, s. At its first start, the twin compiles its kernel.
NODES_TIMEOUT_S = 120.0
NODE_S = 5.0  # timeout for the discovery of a node that may be missing, s


class RobotGraph:
    """Nodes, topics and services in the namespace of a node.

    Args:
        node: the node. Its executor spins during waits.
    """

    def __init__(self, node: ServiceCaller) -> None:
        self._node = node

    def wait_for_nodes(self, names: Iterable[str]) -> None:
        """Wait until nodes exist in this namespace. Raises `OperatorError`, with the name of a missing node."""
        expected = set(names)
        self._node.wait(lambda: expected <= self._node_names(), NODES_TIMEOUT_S)
        if missing := expected - self._node_names():
            raise OperatorError(f"no node {min(missing)} within {NODES_TIMEOUT_S:g} s")

    def has_node(self, name: str) -> bool:
        """Wait up to `NODE_S` for a node in this namespace; return True if it exists."""
        return self._node.wait(lambda: name in self._node_names(), NODE_S)

    def publishers(self, topic: str) -> int:
        """Return the number of publishers of a topic of this namespace."""
        return int(self._node.count_publishers(self._node.resolve_topic_name(topic)))

    def wait_for_publisher(self, topic: str, remedy: str) -> None:
        """Wait until a topic has a publisher. Raises `OperatorError`, with ``remedy`` as advice, if it gets none."""
        if not self._node.wait(lambda: self.publishers(topic) > 0, DISCOVERY_TIMEOUT_S):
            name = self._node.resolve_topic_name(topic)
            raise OperatorError(f"{name} has no publisher: {remedy}")

    def require_sole_driver(self) -> None:
        """Raise `OperatorError` if several drivers would execute a command.

        A request reaches all servers of a service. This method counts the drivers by their service `DRIVER_SERVICE`.
        The node discovers a driver's end late if its process was killed. The method therefore waits up to
        `ANNOUNCED_S` until it counts at most one driver.
        """
        service = self._node.resolve_service_name(DRIVER_SERVICE)

        def count() -> int:
            return int(self._node.count_services(service))

        if not self._node.wait(lambda: count() <= 1, ANNOUNCED_S):
            raise OperatorError(
                f"{self._node.get_namespace()} has {count()} drivers, and all of them would move: end all but one, or "
                "give each its own namespace or ROS_DOMAIN_ID"
            )

    def wait_for_recorder(self, name: str) -> None:
        """Wait until a recorder has subscribed to all topics of this namespace that have publishers, except images.

        Without this wait, the recording would lack the first messages.

        Args:
            name: name of the recorder's node.

        Raises:
            OperatorError: The recorder did not subscribe in time. The message contains a missing topic.
        """
        self._node.wait(lambda: not self._topics_without(name), DISCOVERY_TIMEOUT_S)
        if topics := self._topics_without(name):
            raise OperatorError(f"{name} does not subscribe to {topics[0]}")

    def _topics_without(self, subscriber: str) -> list[str]:
        node, prefix = self._node, self._node.get_namespace().rstrip("/") + "/"
        return [
            topic
            for topic, types in node.get_topic_names_and_types()
            if topic.startswith(prefix)
            and "/_" not in topic
            and IMAGES.isdisjoint(types)
            and node.count_publishers(topic) > 0
            and subscriber not in [i.node_name for i in node.get_subscriptions_info_by_topic(topic)]
        ]

    def _node_names(self) -> set[str]:
        own = self._node.get_namespace()
        return {name for name, space in self._node.get_node_names_and_namespaces() if space == own}
