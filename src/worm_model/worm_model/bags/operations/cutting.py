# SPDX-License-Identifier: Apache-2.0
"""Extraction of a time span from a bag, and joining of bags. The same input gives the same bytes."""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Sequence
from operator import attrgetter
from pathlib import Path

from worm_model.bags.bag import Bag
from worm_model.bags.bag_errors import BagError
from worm_model.bags.formats.bag_writer import new_bag
from worm_model.bags.formats.cdr import defined_message
from worm_model.bags.formats.message_block import Message
from worm_model.bags.formats.message_types import with_definition
from worm_model.bags.worm_topics import LATCHED


def trim(bag: Bag, output: Path, first: int, last: int) -> int:
    """Write the messages with log times from ``first`` to ``last`` (ns since the epoch); return their number.

    The last message of each latched topic before the span is included. Its log time is the start of the span, because
    a subscriber that starts then would receive it.

    Raises:
        BagError: The span contains no message, or the output exists.
    """
    with new_bag(output) as writer:
        writer.copy_records(bag)
        for channel in bag.channels:
            writer.add_topic(with_definition(channel))
        count = writer.write_all(map(defined_message, _within(bag, first, last)))
        if not count:  # then nothing has been written
            raise BagError(
                f"{bag.path} holds no message from {_since(bag, first):.3f} s to {_since(bag, last):.3f} s; it is "
                f"{_since(bag, bag.end):.3f} s long: give a span with messages"
            )
        return count


def _since(bag: Bag, time: int) -> float:
    return (time - bag.start) * 1e-9


def _within(bag: Bag, first: int, last: int) -> Iterator[Message]:
    """Yield the messages of a span, preceded by the latched messages that were valid at its start."""
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
            yield from (word._replace(log_time=first) for word in held.values())
            begun = True
        yield message


def merge(bags: Sequence[Bag], output: Path) -> int:
    """Write the messages of all bags in order of log time; return their number.

    At equal times, the order is that of ``bags``.

    Metadata and attachments of all bags are included. If bags have metadata of the same name, readers use the last
    record. `worm_model.bags.recording.run_manifest.recorded_parameters` rejects different parameter files.

    Raises:
        BagError: The output exists.
    """
    with new_bag(output) as writer:
        for bag in bags:
            writer.copy_records(bag)
            for channel in bag.channels:
                writer.add_topic(with_definition(channel))
        series = [map(defined_message, bag.messages()) for bag in bags]
        return writer.write_all(heapq.merge(*series, key=attrgetter("log_time")))
