# SPDX-License-Identifier: Apache-2.0
"""Raw subscriptions to any topics, for recording.

The subscriptions and the recorder's services, those of its parameters included, are polled, not spun: an executor
spends some 0.2 ms of Python a message, a look at a subscription that takes all that is waiting a hundredth of it, and
the stamps come from the middleware, so that polling costs no accuracy.
"""

from __future__ import annotations

import importlib
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSCompatibility, QoSProfile, qos_check_compatible
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription
from std_srvs.srv import Trigger

from worm_model.bags.bag_errors import BagError, DefinitionError
from worm_model.bags.formats.bag_metadata import dump_yaml
from worm_model.bags.formats.message_block import Message, Topic
from worm_model.bags.formats.message_types import installed_definition
from worm_model.bags.recording.message_loss import LossCounter
from worm_model.bags.recording.topic_selection import TopicSelection
from worm_model.bags.worm_topics import GAIT_STATE, TWIN_EVENT
from worm_model.nodes.recording_qos import describe, subscription_qos
from worm_model.run import INACTIVE
from worm_msgs.node_command import declare_none

# with both subscriptions: publishers learn of the second one later than it does of them
OVERLAP_LOOKS = 50

SETTLING_S = 3.0  # after which a publisher that appears was not there before the recorder

_Identity = tuple[int, int]


class _RawSubscription:
    """A subscription that is looked at instead of called back.

    When a publisher comes that offers less, a second subscription that it can serve is made beside the first, which
    stays until the second is connected to all: nothing is lost in between, and what both receive is taken once.
    """

    def __init__(self, node: Node, topic: Topic, message: type, depth: int) -> None:
        self.topic = topic
        self.loss = LossCounter(lambda: node.count_publishers(topic.name))
        self._node = node
        self._message = message
        self._depth = depth
        self._recent: deque[_Identity] = deque(maxlen=depth)
        self._old: Subscription | None = None
        self._connected_looks = 0
        self.qos, self._subscription = self._subscribe()

    def _subscribe(self) -> tuple[QoSProfile, Subscription]:
        publishers = self._node.get_publishers_info_by_topic(self.topic.name)
        qos = subscription_qos([info.qos_profile for info in publishers], self._depth)
        subscription = self._node.create_subscription(
            self._message, self.topic.name, lambda _: None, qos, raw=True
        )
        return qos, subscription

    def take(self) -> list[Message]:
        """All that is waiting."""
        if self._old is None:
            return [self._sample(*taken) for taken in self._waiting(self._subscription)]
        known = set(self._recent)
        samples = []
        for subscription in (self._old, self._subscription):
            for data, info in self._waiting(subscription):
                if _identity(info) not in known:
                    known.add(_identity(info))
                    samples.append(self._sample(data, info))
        self._connected_looks += self._is_connected()
        if self._connected_looks > OVERLAP_LOOKS:
            self._node.destroy_subscription(self._old)
            self._node.get_logger().info(f"{self.topic.name}: the old subscription is given up")
            self._old = None
        return samples

    def _waiting(self, subscription: Subscription) -> Iterator[tuple[bytes, dict[str, int]]]:
        handle = subscription.handle
        with handle:
            while (taken := handle.take_message(self._message, True)) is not None:
                yield taken

    def _sample(self, data: bytes, info: dict[str, int]) -> Message:
        self.loss.observe(info["publication_sequence_number"])
        self._recent.append(_identity(info))
        received, sent = info["received_timestamp"], info["source_timestamp"]
        return Message(self.topic.name, received, data, sent, self.topic)

    def _is_connected(self) -> bool:
        publishers = self._node.count_publishers(self.topic.name)
        return self._subscription.get_publisher_count() >= publishers

    def hears_all(self) -> bool:
        """Whether every publisher that there is now can serve this subscription."""
        return all(
            qos_check_compatible(info.qos_profile, self.qos)[0] != QoSCompatibility.ERROR
            for info in self._node.get_publishers_info_by_topic(self.topic.name)
        )

    def resubscribe(self) -> None:
        """Adapt to the publishers that there are now."""
        if self._old is not None:
            self._node.destroy_subscription(self._subscription)  # the old one has what was received
        else:
            self._old = self._subscription
        self._connected_looks = 0
        self.qos, self._subscription = self._subscribe()


def _identity(info: dict[str, int]) -> _Identity:
    """What tells a message of a topic from another: the publisher's number and time of sending."""
    return info["publication_sequence_number"], info["source_timestamp"]


class RecordNode(Node):
    """Subscribes to the selected topics as they appear.

    Args:
        selection: which ones; names relative to the node's namespace are resolved.
        depth: messages of a topic that may wait between two looks.
    """

    def __init__(self, selection: TopicSelection, depth: int) -> None:
        super().__init__("recorder")
        declare_none(self)
        names = frozenset(map(self._full_name, selection.names))
        self._selection = replace(selection, names=names)
        self._depth = depth
        self._subscriptions_by_name: dict[str, _RawSubscription] = {}
        self._refused: set[str] = set()
        self._run, self._onset = 0, 0  # of the gait that was noted last
        self._noted = False
        self._drivers: dict[str, int] = {}  # the last state, by topic
        self._settled = time.monotonic() + SETTLING_S

    def _full_name(self, name: str) -> str:
        try:
            return self.resolve_topic_name(name)
        except Exception as error:  # noqa: BLE001 - rclpy raises several kinds, of which not all are public
            reason = str(error).splitlines()[0]
            raise BagError(f"{name!r} is not a name of a topic: {reason}") from None

    def offer_service(self, name: str, act: Callable[[], str]) -> None:
        """A service ``~/name`` that does something and answers in words; a BagError is its refusal."""

        def serve(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            try:
                response.success, response.message = True, act()
            except (BagError, OSError) as error:
                response.success, response.message = False, " ".join(str(error).split())
            self.get_logger().info(f"{name}: {response.message}")
            return response

        self.create_service(Trigger, f"~/{name}", serve)

    def serve(self) -> None:
        """Answer the requests to all services of the node, its parameters' included, since the last call."""
        for service in self.services:
            kind = service.srv_type
            while True:
                with service.handle:
                    request, header = service.handle.service_take_request(kind.Request)
                if header is None:
                    break
                service.send_response(service.callback(request, kind.Response()), header)

    @property
    def missed(self) -> dict[str, int]:
        """Messages, by topic, that publishers which came later had sent before the recorder heard them."""
        by_name = self._subscriptions_by_name.items()
        return {name: s.loss.missed for name, s in by_name if s.loss.missed}

    @property
    def lost(self) -> int:
        """Messages that publishers sent and that did not arrive."""
        return sum(subscription.loss.lost for subscription in self._subscriptions_by_name.values())

    @property
    def missing(self) -> list[str]:
        """Topics that were named and have not been seen."""
        return sorted(self._selection.names - self._subscriptions_by_name.keys())

    @property
    def topics(self) -> list[Topic]:
        """Topics subscribed to."""
        return [subscription.topic for subscription in self._subscriptions_by_name.values()]

    def discover(self) -> None:
        """Subscribe to what is new, adapt to new publishers of what is not."""
        for subscription in self._subscriptions_by_name.values():
            if not subscription.hears_all():
                subscription.resubscribe()
                self.get_logger().warning(
                    f"{subscription.topic.name}: a new publisher offers less; adapted to it"
                )
        for name, types in self.get_topic_names_and_types():
            new = name not in self._subscriptions_by_name and name not in self._refused
            if new and self._selection.takes(name) and self.count_publishers(name):
                self._subscribe(name, types)
        if time.monotonic() < self._settled:
            for name, subscription in self._subscriptions_by_name.items():
                subscription.loss.expect(self.count_publishers(name))

    def _subscribe(self, name: str, types: Sequence[str]) -> None:
        try:
            if len(types) != 1:
                raise DefinitionError(f"it has several types: {', '.join(types)}")
            definition = installed_definition(types[0])
            message = message_class(types[0])
        except BagError as error:
            self._refused.add(name)
            self.get_logger().error(f"{name} is not recorded: {error}")
            return
        publishers = self.get_publishers_info_by_topic(name)
        type_hash = str(publishers[0].topic_type_hash) if publishers else ""
        profiles = describe(publishers)
        metadata = (
            ("offered_qos_profiles", dump_yaml(list(profiles)) if profiles else ""),
            ("topic_type_hash", type_hash),
        )
        topic = Topic(name, types[0], 0, definition, "ros2msg", "cdr", metadata)
        self._subscriptions_by_name[name] = _RawSubscription(self, topic, message, self._depth)
        self.get_logger().info(f"recording {name} ({types[0]})")

    def take(self) -> list[Message]:
        """All messages that are waiting, of all topics."""
        return [
            sample
            for subscription in self._subscriptions_by_name.values()
            for sample in subscription.take()
        ]

    def new_gaits(self, samples: Sequence[Message]) -> Iterator[dict[str, str]]:
        """The gaits that have begun according to the messages, each once for its run."""
        for sample in samples:
            if sample.channel.type_name == GAIT_STATE:
                state: Any = deserialize_message(sample.data, message_class(GAIT_STATE))
                self._drivers[sample.topic] = state.state
                gait = _describe_gait(state)
                if gait and not self._is_known(state):
                    yield gait

    @property
    def awaits_rest(self) -> bool:
        """Whether a driver that was heard is there and has not let go of its robot."""
        return any(
            state != INACTIVE and self.count_publishers(topic) > 0
            for topic, state in self._drivers.items()
        )

    def alarm(self, samples: Sequence[Message]) -> str:
        """What the twin raises an alarm about in the messages, the last one; empty without one."""
        events: list[Any] = [
            deserialize_message(sample.data, message_class(TWIN_EVENT))
            for sample in samples
            if sample.channel.type_name == TWIN_EVENT
        ]
        return next((e.message or e.code for e in reversed(events) if e.code), "")

    def _is_known(self, state: Any) -> bool:
        """Whether a gait's state is of the run that was noted last; a driver that restarts counts anew."""
        onset = state.onset.sec * 10**9 + state.onset.nanosec
        known = self._noted and state.run == self._run and (onset == self._onset or not self._onset)
        self._noted, self._run, self._onset = True, state.run, onset
        return known


def message_class(type_name: str) -> type:
    """Python class of ``package/msg/Type``.

    Raises:
        DefinitionError: its package is not installed.
    """
    package, _, kind = type_name.partition("/msg/")
    try:
        kind_class: type = getattr(importlib.import_module(f"{package}.msg"), kind)
    except (ImportError, AttributeError, ValueError, TypeError):  # the latter two of odd names
        name = type_name or "a type that is not told"
        raise DefinitionError(
            f"{name} is not installed; source the workspace that has it"
        ) from None
    return kind_class


def _describe_gait(state: Any) -> dict[str, str]:
    """A running gait as text; empty when none runs."""
    if state.state != state.RUNNING or state.gait.stroke <= 0.0:
        return {}
    gait = {key: repr(getattr(state.gait, key)) for key in state.gait.get_fields_and_field_types()}
    return gait | {
        "cycles": str(state.cycles),
        "onset_ns": str(state.onset.sec * 10**9 + state.onset.nanosec),
        "run": str(state.run),
    }
