# SPDX-License-Identifier: Apache-2.0
"""``worm_model play``: playback of a bag with its timing, and of the bag's time on /clock."""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

from builtin_interfaces.msg import Time
from rclpy.duration import Duration
from rclpy.exceptions import InvalidTopicNameException
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock

from worm_model.bags.formats.bag_errors import BagError
from worm_model.bags.formats.bag_metadata import first_qos_profile, is_latched
from worm_model.bags.formats.cdr import is_whole, types_of
from worm_model.bags.formats.message_block import Message, Topic
from worm_model.bags.formats.message_types import topic_of
from worm_model.bags.opening import Bag, open_bag
from worm_model.commands.command_line import (
    InputError,
    Parser,
    not_negative,
    notifier,
    number,
    run_command,
)
from worm_model.nodes.raw_subscriptions import message_class
from worm_msgs.claim import ClaimedError, claim_robot
from worm_msgs.node_command import declare_none
from worm_msgs.ros_process import own_arguments, ros_process

LONGEST_WAIT_S = 0.005  # between two polls of the services
TWIN = "twin"  # name of the twin's node
UNCHANGED_S = 1.0  # time without a change of the subscribers before the first message
MATCHING_S = 3.0  # timeout for a subscriber that cannot be connected
ACKNOWLEDGED_S = 2.0  # timeout for the last messages to reach their subscribers
LATEST_S = 2**31 - 1  # s since the epoch, the latest time of a message (year 2038)
VOLATILE_DEPTH = 1000  # samples that may wait for a slow subscriber


def play_qos(topic: Topic) -> QoSProfile:
    """Return the quality of service of a played topic, which is that of its first recorded publisher.

    If the bag contains no quality of service, the topic is reliable and latched. This is compatible with every
    subscriber. Late subscribers of a latched topic receive as many samples as from that publisher, or 1 if its depth is
    unknown or larger than VOLATILE_DEPTH.
    """
    offered = first_qos_profile(topic)
    latched = is_latched(topic) or not offered
    best_effort = offered.get("reliability") == "best_effort"
    depth = offered.get("depth")
    if not isinstance(depth, int) or not 0 < depth <= VOLATILE_DEPTH:
        depth = 1
    return QoSProfile(
        depth=depth if latched else VOLATILE_DEPTH,
        reliability=ReliabilityPolicy.BEST_EFFORT if best_effort else ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


class PlayNode(Node):
    """Node that plays a bag.

    Args:
        bag: an open bag.
        options: options of the command line.
    """

    def __init__(self, bag: Bag, options: argparse.Namespace) -> None:
        super().__init__("player")
        declare_none(self)
        self._bag = bag
        self._options = options
        self._first_ns = bag.time_at(options.start)
        self._played: dict[Topic, Topic] = {}  # with the installed definition, by channel
        self._skipped: set[str] = set()  # topics with messages that are not whole
        self._publishers_by_topic = self._advertise()
        self._clock_publisher = self.create_publisher(Clock, "/clock", 10)
        self._clock_due = 0.0
        self._pending: Message | None = None
        self._messages: Iterator[Message] = iter(())
        # wall time of the first message (monotonic, s), once the subscribers are connected
        self._begin = math.inf
        self._subscribers: dict[str, tuple[int, int]] = {}
        self._changed = time.monotonic()  # time of the last change of the subscribers
        self._awaits_twin: bool = options.twin
        if options.twin:  # The player takes the place of the robot of its namespace.
            self._claim = claim_robot(self.get_namespace(), self.context.get_domain_id())
            self.get_logger().info("waiting for the twin to subscribe")
        self.finished = False
        self.published = 0
        self._rewind()

    def _advertise(self) -> dict[str, Publisher]:
        publishers: dict[str, Publisher] = {}
        for channel in self._selected():
            try:
                kind = message_class(channel.type_name)
                installed = self._installed(channel)
                known = publishers.get(channel.name)
                if known is not None and known.msg_type is not kind:
                    raise BagError(f"it is played as another type; {channel.type_name} is left out")
                if known is None:
                    qos = play_qos(channel)
                    publishers[channel.name] = self.create_publisher(kind, channel.name, qos)
            except (BagError, InvalidTopicNameException) as error:
                reason = str(error).splitlines()[0]
                self.get_logger().warning(f"{channel.name!r} is not played: {reason}")
                continue
            self._played[channel] = installed
        if not publishers:
            raise InputError(f"{self._bag.path}: none of its topics can be played")
        return publishers

    @staticmethod
    def _installed(channel: Topic) -> Topic:
        """Return the topic with the installed definition. Raises BagError if the bag has another one."""
        installed = topic_of(channel.name, channel.type_name)
        if types_of(channel) != types_of(installed):
            raise BagError(
                f"the {channel.type_name} of the bag differs from the installed definition"
            )
        return installed

    def _selected(self) -> Iterator[Topic]:
        for channel in self._bag.channels:
            if channel.name != "/clock" and not (self._options.twin and _is_of_twin(channel.name)):
                yield channel

    def _rewind(self) -> None:
        """Go to the start time: publish the last earlier message of each latched topic, and set the clock."""
        self._messages = self._bag.messages(self._publishers_by_topic)
        self._pending = None
        latched: dict[str, Message] = {}
        for message in self._messages:
            if message.log_time >= self._first_ns:
                self._pending = message
                break
            latched[message.topic] = message
        for message in latched.values():
            if is_latched(message.channel):
                self._publish(message)
        self._publish_clock(self._first_ns)

    def advance(self) -> float:
        """Publish the messages that are due, and return the wall time (monotonic, s) at which to call this again."""
        wall = time.monotonic()
        if self._begin > wall and not self._is_awaiting_twin() and self._is_connected(wall):
            self._report_other_publishers()
            self._begin = wall
        while self._pending and self._due(self._pending.log_time) <= wall:
            self._publish(self._pending)
            self._pending = next(self._messages, None)
        if self._pending is None and self._begin <= wall:
            self._end(wall)
        if self._options.clock and wall >= self._clock_due:
            self._clock_due = wall + 1.0 / self._options.clock
            passed = max(wall - self._begin, 0.0) * self._options.rate
            self._publish_clock(self._bag.time_at(self._options.start + passed))
        due = min(wall + LONGEST_WAIT_S, self._clock_due if self._options.clock else math.inf)
        return min(due, self._due(self._pending.log_time)) if self._pending else due

    def _due(self, log_time: int) -> float:
        """Return the wall time (monotonic, s) at which a message with a log time (ns) is due."""
        position = self._bag.position_at(log_time) - self._options.start
        return self._begin + position / self._options.rate

    def _report_other_publishers(self) -> None:
        """Log the played topics that other nodes publish as well, such as those of a running driver."""
        own = self.get_name(), self.get_namespace()
        for topic in self._publishers_by_topic:
            publishers = self.get_publishers_info_by_topic(topic)
            others = {(info.node_name, info.node_namespace) for info in publishers} - {own}
            for name, space in sorted(others):
                self.get_logger().warning(
                    f"{topic} is also published by {space.rstrip('/')}/{name}: subscribers receive both, and cannot "
                    "distinguish them"
                )

    def _is_connected(self, wall: float) -> bool:
        """Return True if the number of subscribers has not changed for `UNCHANGED_S`.

        While some known subscribers are not connected, this time is longer by MATCHING_S. The two sides of a connection
        discover each other at different times, and subscribers are discovered one by one.
        """
        publishers = [self._clock_publisher, *self._publishers_by_topic.values()]
        counts = {
            p.topic_name: (p.get_subscription_count(), self.count_subscribers(p.topic_name))
            for p in publishers
        }
        if counts != self._subscribers:
            self._subscribers, self._changed = counts, wall
        connected = all(reached >= known for reached, known in counts.values())
        delay = UNCHANGED_S + (0.0 if connected else MATCHING_S)
        return wall >= self._changed + delay

    def _is_awaiting_twin(self) -> bool:
        """Return True while --twin is given and the twin does not subscribe yet."""
        if self._awaits_twin:
            twin = TWIN, self.get_namespace()
            self._awaits_twin = all(
                twin != (info.node_name, info.node_namespace)
                for topic in self._publishers_by_topic
                for info in self.get_subscriptions_info_by_topic(topic)
            )
        return self._awaits_twin

    def _publish(self, message: Message) -> None:
        if message.channel not in self._played:
            return
        if not is_whole(self._played[message.channel], message.data):
            if message.topic not in self._skipped:
                self.get_logger().warning(
                    f"{message.topic} is played without the messages that are not as long as their definition requires"
                )
            self._skipped.add(message.topic)
            return
        self._publishers_by_topic[message.topic].publish(message.data)
        self.published += 1

    def _publish_clock(self, now_ns: int) -> None:
        if self._options.clock:
            stamp = Time(sec=min(now_ns // 10**9, LATEST_S), nanosec=now_ns % 10**9)
            self._clock_publisher.publish(Clock(clock=stamp))

    def _end(self, wall: float) -> None:
        if self._options.loop:
            self._rewind()
            self._begin = wall
        else:
            self.finished = True

    def drain(self) -> None:
        """Wait until reliable subscribers have received all messages, but for at most ACKNOWLEDGED_S per topic."""
        deadline = Duration(seconds=ACKNOWLEDGED_S)
        for publisher in self._publishers_by_topic.values():
            publisher.wait_for_all_acked(deadline)


def _is_of_twin(name: str) -> bool:
    """Return True for a topic that a live twin publishes."""
    own = name.endswith(("/body_length/estimated", "/tf")) or name == "/diagnostics"
    return own or "/twin/" in name


def _positive(text: str) -> float:
    value = number(text)
    if value <= 0.0:
        raise argparse.ArgumentTypeError(f"{text}: it must be above 0")
    return value


def _parser() -> Parser:
    parser = Parser(
        prog="play",
        description="Publish a bag with its timing, and its time on /clock for nodes with use_sim_time.",
    )
    parser.add_argument("bag", type=Path, metavar="BAG")
    parser.add_argument(
        "-r", "--rate", type=_positive, default=1.0, help="bag time per wall time (default 1)"
    )
    parser.add_argument("-l", "--loop", action="store_true", help="start again at the end")
    parser.add_argument(
        "--start",
        type=not_negative,
        default=0.0,
        metavar="S",
        help="play from this time on, in s since the start of the bag",
    )
    parser.add_argument(
        "--twin",
        action="store_true",
        help="for the live twin in the player's namespace: begin when the twin subscribes, and leave out the topics "
        "that it publishes",
    )
    parser.add_argument(
        "--clock",
        type=not_negative,
        default=100.0,
        metavar="HZ",
        help="rate of /clock, 0: none (default 100)",
    )
    return parser


def _play(ended: Callable[[], bool], options: argparse.Namespace) -> None:
    with open_bag(options.bag, notifier("play")) as bag:
        length = bag.duration_s
        if not bag.message_count:
            raise InputError(f"{options.bag} contains no messages")
        if options.start > length:
            raise InputError(
                f"--start {options.start:g} is after the end: the bag is {length:.2f} s long"
            )
        try:
            node = PlayNode(bag, options)
        except ClaimedError as error:
            raise InputError(str(error)) from None
        node.get_logger().info(f"playing {bag.path}: {bag.message_count} messages, {length:.1f} s")
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        try:
            _spin(node, executor, ended)
        finally:
            sys.stderr.write(f"play: {node.published} messages published\n")
            executor.shutdown()
            node.destroy_node()


def _spin(node: PlayNode, executor: SingleThreadedExecutor, ended: Callable[[], bool]) -> None:
    while not (node.finished or ended()):
        due = node.advance()
        executor.spin_once(timeout_sec=0.0)
        time.sleep(max(due - time.monotonic(), 0.0))
    node.drain()


def main() -> int:
    """Entry point of the executable play."""
    with ros_process() as ended:
        return run_command(_parser(), partial(_play, ended), own_arguments(sys.argv)[1:])
