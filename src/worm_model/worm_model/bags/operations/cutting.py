# SPDX-License-Identifier: Apache-2.0
"""Copies of bags: a part in time, several bags merged, or other messages. Equal inputs produce equal bytes."""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator, Sequence
from operator import attrgetter
from pathlib import Path

from worm_model.bags.formats.bag import Bag
from worm_model.bags.formats.bag_errors import BagError
from worm_model.bags.formats.bag_writer import new_bag
from worm_model.bags.formats.cdr import defined_message
from worm_model.bags.formats.message_block import Message, Topic
from worm_model.bags.formats.message_types import with_definition
from worm_model.bags.worm_topics import LATCHED


def write_copy(
    bags: Sequence[Bag],
    output: Path,
    series: Iterable[Iterable[Message]],
    topics: Iterable[Topic] | None = None,
) -> int:
    """Write a bag with metadata and attachments of other bags; return the number of its messages.

    Args:
        bags: sources of metadata and attachments.
        output: the new bag.
        series: iterables of messages, each in order of log time. At equal times, the order of the iterables decides.
        topics: topics to list; None: the topics of ``bags``.

    Raises:
        BagError: The output exists, or a topic has no definition.
    """
    with new_bag(output) as writer:
        for bag in bags:
            writer.copy_records(bag)
        for topic in (c for bag in bags for c in bag.channels) if topics is None else topics:
            writer.add_topic(with_definition(topic))
        messages = heapq.merge(*series, key=attrgetter("log_time"))
        return writer.write_all(map(defined_message, messages))


def trim(bag: Bag, output: Path, first: int, last: int) -> int:
    """Write the messages with log times from ``first`` to ``last`` (ns since the epoch); return their number.

    The last message of each latched topic before the span is included, because a subscriber that joins at the start
    of the span would receive it. Its log time is set to the start of the span.

    Raises:
        BagError: The span contains no message, the output exists, or a topic has no definition.
    """
    return write_copy([bag], output, [_within(bag, first, last)])


def _within(bag: Bag, first: int, last: int) -> Iterator[Message]:
    """Yield the messages of a span, preceded by the latest earlier message of each latched topic."""
    held: dict[str, Message] = {}
    begun = False
    for message in bag.messages():
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
        start, end, length = ((time - bag.start) * 1e-9 for time in (first, last, bag.end))
        raise BagError(
            f"{bag.path} holds no message from {start:.3f} s to {end:.3f} s of its {length:.3f} s: give a span "
            "with messages"
        )


def merge(bags: Sequence[Bag], output: Path) -> int:
    """Write the messages of all bags in order of log time; return their number.

    Messages with equal times are in the order of ``bags``.

    Metadata and attachments of all bags are included. If bags have metadata of the same name, readers use the last
    record. `worm_model.bags.recording.run_manifest.recorded_parameters` rejects different parameter files.

    Raises:
        BagError: The output exists, or a topic has no definition.
    """
    return write_copy(bags, output, [bag.messages() for bag in bags])
