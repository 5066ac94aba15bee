# SPDX-License-Identifier: Apache-2.0
"""Raw subscriptions to any topics, for recording.

The node polls its subscriptions and services, including those of its parameters, instead of spinning. An executor
needs about 0.2 ms of Python per message. A poll reads all waiting messages, in a hundredth of this time per message.
Polling does not affect the accuracy of stamps, because they come from the middleware.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from typing import Any

from rclpy.node import Node
from rclpy.qos import (
    DurabilityPolicy,
    HistoryPolicy,
    QoSCompatibility,
    QoSProfile,
    ReliabilityPolicy,
    qos_check_compatible,
)
from rclpy.serialization import deserialize_message
from rclpy.topic_endpoint_info import TopicEndpointInfo
from std_srvs.srv import Trigger

from worm_model.bags.formats.bag_errors import BagError, DefinitionError
from worm_model.bags.formats.bag_metadata import dump_yaml, qos_profile
from worm_model.bags.formats.message_block import Message, Topic
from worm_model.bags.formats.message_types import installed_definition
from worm_model.bags.worm_topics import GAIT_STATE, IMAGES, TWIN_EVENT
from worm_model.run import Activity
from worm_model.twin.cause_table import NEAR_EDGE
from worm_msgs.node_command import declare_none

DEPTH = 1000  # messages of a topic that may wait between two polls


class LossCounter:
    """Counter of the lost messages of one topic, based on the publisher's sequence numbers.

    The middleware numbers the messages of each publisher (1, 2, 3, …) but does not identify the publisher of a number.
    Gaps are therefore counted only while the topic has one publisher.

    Args:
        publishers: returns the present number of publishers of the topic; called only for a number out of sequence.

    Attributes:
        lost: number of missing messages.
    """

    def __init__(self, publishers: Callable[[], int]) -> None:
        self._publishers = publishers
        self._last = 0
        self._alone = True  # at the previous number out of sequence
        self.lost = 0

    def observe(self, sequence: int) -> None:
        """Account for a received message with a sequence number, which its publisher counts from 1."""
        gap = sequence - self._last - 1
        if self._last and gap:
            before, self._alone = self._alone, self._publishers() == 1
            if gap > 0 and before and self._alone:
                self.lost += gap
        self._last = sequence


class _RawSubscription:
    """Subscription that is polled. Its quality of service suits the publishers that exist when it is created."""

    def __init__(self, node: Node, topic: Topic, message: type) -> None:
        self.topic = topic
        self.loss = LossCounter(lambda: node.count_publishers(topic.name))
        self._message = message
        publishers = node.get_publishers_info_by_topic(topic.name)
        self._qos = _subscription_qos([info.qos_profile for info in publishers])
        self._subscription = node.create_subscription(
            message, topic.name, lambda _: None, self._qos, raw=True
        )

    def take(self) -> Iterator[Message]:
        """Yield all waiting messages."""
        handle = self._subscription.handle
        with handle:
            while (taken := handle.take_message(self._message, True)) is not None:
                data, info = taken
                self.loss.observe(info["publication_sequence_number"])
                received, sent = info["received_timestamp"], info["source_timestamp"]
                yield Message(self.topic.name, received, data, sent, self.topic)

    def misses(self, publisher: TopicEndpointInfo) -> bool:
        """Return True if a publisher offers less than this subscription requires, and is not received."""
        return bool(
            qos_check_compatible(publisher.qos_profile, self._qos)[0] == QoSCompatibility.ERROR
        )


def _subscription_qos(offered: Sequence[QoSProfile]) -> QoSProfile:
    """Return the strictest quality of service that is compatible with every publisher.

    A best-effort publisher does not connect to a reliable subscription, and a volatile publisher does not connect to a
    transient-local subscription. A volatile subscription would miss latched messages.
    """
    reliable = all(qos.reliability == ReliabilityPolicy.RELIABLE for qos in offered)
    latched = all(qos.durability == DurabilityPolicy.TRANSIENT_LOCAL for qos in offered)
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=DEPTH,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def _describe_qos(publishers: Sequence[TopicEndpointInfo]) -> list[Mapping[str, Any]]:
    """Return the different profiles that a topic's publishers offer, for metadata.yaml."""
    profiles: list[Mapping[str, Any]] = []
    for publisher in publishers:
        qos = publisher.qos_profile
        profile = qos_profile(
            history=qos.history.short_key,
            depth=qos.depth,
            reliability=qos.reliability.short_key,
            durability=qos.durability.short_key,
            liveliness=qos.liveliness.short_key,
            times=(
                qos.deadline.nanoseconds,
                qos.lifespan.nanoseconds,
                qos.liveliness_lease_duration.nanoseconds,
            ),
        )
        if profile not in profiles:
            profiles.append(profile)
    return profiles


class RecordNode(Node):
    """Node that subscribes to topics as they appear.

    Args:
        names: the topics; names relative to the node's namespace are resolved. If empty: all topics of the namespace
            and /diagnostics, except IMAGES.
    """

    def __init__(self, names: Iterable[str]) -> None:
        super().__init__("recorder")
        declare_none(self)
        self._names = frozenset(map(self._full_name, names))
        self._subscriptions_by_name: dict[str, _RawSubscription] = {}
        self._rejected: dict[str, str] = {}  # reason by name of a topic that cannot be recorded
        self._drivers: dict[str, int] = {}  # last state of each driver, by topic
        self._warned: set[str] = set()

    def _full_name(self, name: str) -> str:
        try:
            return self.resolve_topic_name(name)
        except Exception as error:  # noqa: BLE001 - rclpy raises several kinds, of which not all are public
            reason = str(error).splitlines()[0]
            raise BagError(f"{name!r} is not a name of a topic: {reason}") from None

    def offer_service(self, name: str, act: Callable[[], str]) -> None:
        """Create a service ``~/name`` that runs ``act`` and responds with its text, or with the text of its error."""

        def serve(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            try:
                response.success, response.message = True, act()
            except (BagError, OSError) as error:
                response.success, response.message = False, " ".join(str(error).split())
            self.get_logger().info(f"{name}: {response.message}")
            return response

        self.create_service(Trigger, f"~/{name}", serve)

    def serve(self) -> None:
        """Handle the requests to all services of the node, including those of its parameters, since the last call."""
        for service in self.services:
            kind = service.srv_type
            while True:
                with service.handle:
                    request, header = service.handle.service_take_request(kind.Request)
                if header is None:
                    break
                service.send_response(service.callback(request, kind.Response()), header)

    @property
    def lost(self) -> int:
        """Number of messages that publishers sent and that did not arrive."""
        return sum(subscription.loss.lost for subscription in self._subscriptions_by_name.values())

    @property
    def missing(self) -> dict[str, str]:
        """Reasons by name of the topics that were requested by name and are not subscribed."""
        missing = sorted(self._names - self._subscriptions_by_name.keys())
        return {name: self._rejected.get(name, "no publisher was found") for name in missing}

    @property
    def topics(self) -> list[Topic]:
        """Subscribed topics."""
        return [subscription.topic for subscription in self._subscriptions_by_name.values()]

    def discover(self) -> None:
        """Subscribe to new topics, and log publishers that are not recorded."""
        for name, subscription in self._subscriptions_by_name.items():
            for publisher in self.get_publishers_info_by_topic(name):
                if subscription.misses(publisher):
                    self._warn(
                        f"{name}: messages of {publisher.node_name} are not recorded, because it offers a lower "
                        "quality of service than the publishers that were found first; start the recorder again"
                    )
        for name, types in self.get_topic_names_and_types():
            new = name not in self._subscriptions_by_name and name not in self._rejected
            if new and self._selects(name, types) and self.count_publishers(name):
                self._subscribe(name)
            if name in self._subscriptions_by_name and len(types) > 1:
                kind = self._subscriptions_by_name[name].topic.type_name
                others = ", ".join(sorted(set(types) - {kind}))
                self._warn(f"{name} is also published as {others}: only {kind} is recorded")

    def _selects(self, name: str, types: Collection[str]) -> bool:
        if self._names:
            return name in self._names
        hidden = any(part.startswith("_") for part in name.split("/"))  # an action's feedback
        own = name == "/diagnostics" or name.startswith(f"{self.get_namespace().rstrip('/')}/")
        return own and not hidden and IMAGES.isdisjoint(types)

    def _warn(self, line: str) -> None:
        """Log a warning once."""
        if line not in self._warned:
            self._warned.add(line)
            self.get_logger().warning(line)

    def _subscribe(self, name: str) -> None:
        publishers = self.get_publishers_info_by_topic(name)
        if not publishers:
            return  # it has ended in the meantime
        kind = publishers[0].topic_type
        try:
            definition = installed_definition(kind)
            message = message_class(kind)
        except BagError as error:
            self._rejected[name] = str(error)
            self.get_logger().error(f"{name} is not recorded: {error}")
            return
        metadata = (
            ("offered_qos_profiles", dump_yaml(_describe_qos(publishers))),
            ("topic_type_hash", str(publishers[0].topic_type_hash)),
        )
        topic = Topic(name, kind, 0, definition, "ros2msg", "cdr", metadata)
        self._subscriptions_by_name[name] = _RawSubscription(self, topic, message)
        self.get_logger().info(f"recording {name} ({kind})")

    def take(self) -> list[Message]:
        """Return all waiting messages of all topics."""
        return [
            sample
            for subscription in self._subscriptions_by_name.values()
            for sample in subscription.take()
        ]

    def observe(self, samples: Sequence[Message]) -> str:
        """Store the states of drivers in some messages, and return the text of the twin's last alarm in them, or "".

        An event for information is no alarm.
        """
        alarm = ""
        for sample in samples:
            kind = sample.channel.type_name
            if kind in (GAIT_STATE, TWIN_EVENT):
                message: Any = deserialize_message(sample.data, message_class(kind))
                if kind == GAIT_STATE:
                    self._drivers[sample.topic] = message.state
                elif message.code not in ("", NEAR_EDGE.code):
                    alarm = message.message or message.code
        return alarm

    @property
    def awaits_rest(self) -> bool:
        """True while a driver that has published its state is present and is not INACTIVE (torque released)."""
        return any(
            state != Activity.INACTIVE and self.count_publishers(topic) > 0
            for topic, state in self._drivers.items()
        )


def message_class(type_name: str) -> type:
    """Return the Python class of ``package/msg/Type``."""
    package, _, kind = type_name.partition("/msg/")
    try:
        kind_class: type = getattr(importlib.import_module(f"{package}.msg"), kind)
    except (
        ImportError,
        AttributeError,
        ValueError,
        TypeError,
    ):  # the latter two for malformed names
        name = type_name or "a type without a name"
        raise DefinitionError(
            f"{name} is not installed; source the workspace that contains it"
        ) from None
    return kind_class
