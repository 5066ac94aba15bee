# SPDX-License-Identifier: Apache-2.0
"""Bags made of bags: a span of one, or several joined. The same input gives the same bytes, and nothing is altered."""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Sequence
from operator import attrgetter
from pathlib import Path

from worm_model.bags.bag import Bag
from worm_model.bags.bag_errors import BagError
from worm_model.bags.bag_writer import new_bag
from worm_model.bags.cdr import defined_message
from worm_model.bags.message_block import Message
from worm_model.bags.message_types import with_definition
from worm_model.bags.worm_topics import LATCHED


def trim(bag: Bag, output: Path, first: int, last: int) -> int:
    """Write the messages whose log times lie from ``first`` to ``last`` (ns since the epoch); returns how many.

    The last word of a latched topic before the span is kept, logged at its start, as one who had come then would have
    heard it.

    Raises:
        BagError: nothing lies in the span, or the output exists.
    """
    if last < bag.start or first > bag.end or last < first:
        raise BagError(
            f"{bag.path} holds nothing from {_since(bag, first):.3f} to {_since(bag, last):.3f} s; it is "
            f"{_since(bag, bag.end):.3f} s long"
        )
    with new_bag(output) as writer:
        writer.copy_records(bag)
        for channel in bag.channels:
            writer.add_topic(with_definition(channel))
        return writer.write_all(map(defined_message, _within(bag, first, last)))


def _since(bag: Bag, time: int) -> float:
    return (time - bag.start) * 1e-9


def _within(bag: Bag, first: int, last: int) -> Iterator[Message]:
    """The messages of a span, behind the latched words that held when it began."""
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
    """Write the messages of all bags by log time, those of an earlier one first; returns how many.

    Metadata and attachments of all are kept; of metadata of one name, readers take the last one's, and different
    parameter files `worm_model.bags.run_manifest.recorded_parameters` refuses.

    Raises:
        BagError: the output exists.
    """
    with new_bag(output) as writer:
        for bag in bags:
            writer.copy_records(bag)
            for channel in bag.channels:
                writer.add_topic(with_definition(channel))
        series = [map(defined_message, bag.messages()) for bag in bags]
        return writer.write_all(heapq.merge(*series, key=attrgetter("log_time")))
