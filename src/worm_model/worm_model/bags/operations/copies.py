# SPDX-License-Identifier: Apache-2.0
"""Copies of bags: a part, or all that can be read of a damaged bag. Equal inputs give equal bytes."""

from __future__ import annotations

import heapq
from collections.abc import Collection, Iterable, Iterator
from operator import attrgetter
from pathlib import Path

from worm_model.bags.formats.bag_errors import BagError
from worm_model.bags.formats.bag_writer import ROSBAG2_RECORD, BagWriter, new_bag
from worm_model.bags.formats.finding import recovered_path
from worm_model.bags.formats.message_block import Message, Topic
from worm_model.bags.opening import LOSS, RECOVERY_RECORD, SOURCE, Bag, open_bag
from worm_model.bags.worm_topics import LATCHED
from worm_model.errors import printable


def write_copy(
    bag: Bag,
    output: Path,
    series: Iterable[Iterable[Message]],
    topics: Iterable[Topic],
) -> int:
    """Write a bag with metadata and attachments of another bag; return the number of its messages.

    Args:
        bag: source of metadata and attachments.
        output: the new bag.
        series: iterables of messages, each in order of log time. At equal times, the order of the iterables decides.
        topics: topics to list.
    """
    with new_bag(output) as writer:
        copy_records(bag, writer)
        if bag.damage:
            loss = printable("; ".join(bag.damage))
            writer.add_metadata(RECOVERY_RECORD, {SOURCE: printable(bag.path.name), LOSS: loss})
        for topic in topics:
            writer.add_topic(topic)
        return writer.write_all(heapq.merge(*series, key=attrgetter("log_time")))


def copy_records(bag: Bag, writer: BagWriter) -> None:
    """Copy the attachments and metadata records of a bag, except rosbag2's copy of metadata.yaml."""
    for attached in bag.attachments():
        writer.add_attachment(attached)
    for record in bag.records:
        if record.name != ROSBAG2_RECORD:
            writer.add_metadata(record.name, dict(record.values))


def recover(path: Path, output: Path | None) -> tuple[Path, int, str]:
    """Write all messages that can be read of a bag to a new one. The old bag is not changed.

    Args:
        path: the bag.
        output: the new bag, which must not exist; None: ``<path>_recovered`` next to the old one.

    Returns:
        (new bag, number of its messages, what is missing in one line, or empty)

    Raises:
        BagError: Nothing of the bag can be read, or the output exists.
        UnwritableError: The operating system cannot create or write the output.
    """
    path = path.resolve() if path.name in ("", "..") else path
    output = recovered_path(path) if output is None else output
    with open_bag(path, lambda _: None) as bag:
        count = write_copy(bag, output, [bag.messages()], bag.channels)
        return output, count, "; ".join([*bag.damage, *bag.remarks])


def write_part(bag: Bag, output: Path, first: int, last: int, topics: Collection[str]) -> int:
    """Write the messages of some topics from log time ``first`` to ``last`` (ns since the epoch); return their number.

    The last message of each latched topic before the span is included, because a subscriber that joins at the start
    of the span would receive it. Its log time is set to the start of the span.
    """
    channels = [channel for channel in bag.channels if channel.name in topics]
    return write_copy(bag, output, [_within(bag, first, last, topics)], channels)


def _within(bag: Bag, first: int, last: int, topics: Iterable[str]) -> Iterator[Message]:
    """Yield the messages of a span, preceded by the latest earlier message of each latched topic."""
    held: dict[str, Message] = {}
    begun = False
    for message in bag.messages(topics):
        if message.log_time > last:
            break
        if message.log_time < first:
            if message.channel.name.endswith(tuple(f"/{name}" for name in LATCHED)):
                held[message.channel.name] = message
            continue
        if not begun:
            yield from (latched._replace(log_time=first) for latched in held.values())
            begun = True
        yield message
    if not begun:
        start, end = (bag.position_at(time) for time in (first, last))
        raise BagError(
            f"{bag.path} holds no such message from {start:.3f} s to {end:.3f} s of its {bag.duration_s:.3f} s: give a "
            "span with messages"
        )
