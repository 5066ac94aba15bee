# SPDX-License-Identifier: Apache-2.0
"""Many messages of several topics in columns: how bags are read and written by the thousand."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from worm_model.bags.payloads import (
    Integers,
    Payloads,
    Times,
    arrange,
    concatenate,
    groups,
    payloads_of,
    time_order,
)


@dataclass(frozen=True)
class MessageBlock:
    """Messages by rising log time; of equal ones, the first comes first.

    Attributes:
        names: full names of topics.
        topic: index into `names` of each message, shape (messages,).
        payloads: the messages with their log times.
        publish_time: when each was sent, ns since the epoch, shape (messages,).
    """

    names: tuple[str, ...]
    topic: Integers
    payloads: Payloads
    publish_time: Times

    def __len__(self) -> int:
        return len(self.topic)

    @property
    def log_time(self) -> Times:
        """When each message was received, ns since the epoch, shape (messages,)."""
        return self.payloads.log_time

    def select(self, chosen: Integers | slice) -> MessageBlock:
        """Some of the messages, in the same buffer."""
        return MessageBlock(
            self.names,
            self.topic[chosen],
            self.payloads.select(chosen),
            self.publish_time[chosen],
        )

    def split(self, log_time: int) -> tuple[MessageBlock, MessageBlock]:
        """Messages from before a time (ns since the epoch), and those from then on, in a buffer of their own."""
        count = int(np.searchsorted(self.log_time, np.uint64(log_time)))
        if not count:
            return self.select(slice(0)), self
        rest = self.select(slice(count, None))
        return self.select(slice(count)), replace_payloads(rest, rest.payloads.compact())

    def by_topic(self) -> Iterator[tuple[str, Payloads]]:
        """Messages of each topic that has any."""
        for index, rows in groups(self.topic):
            yield self.names[index], self.payloads.select(rows)


def replace_payloads(block: MessageBlock, payloads: Payloads) -> MessageBlock:
    """The same messages, which lie elsewhere."""
    return MessageBlock(block.names, block.topic, payloads, block.publish_time)


def block_of(
    names: Sequence[str], topic: Sequence[int], payloads: Payloads, publish_time: Sequence[int]
) -> MessageBlock:
    """A block of messages in any order; arguments as the attributes of MessageBlock."""
    order = np.argsort(payloads.log_time, kind="stable")
    return MessageBlock(
        tuple(names),
        np.array(topic, dtype=np.int64)[order],
        payloads.select(order),
        np.array(publish_time, dtype=np.uint64)[order],
    )


def block_of_topics(messages: Mapping[str, Payloads]) -> MessageBlock:
    """A block of the messages of some topics, each sent when it was received; of equal times in the topics' order."""
    parts = list(messages.values())
    order = time_order(parts)
    payloads = concatenate(parts).select(order)
    counts = np.array([len(part) for part in parts], dtype=np.int64)
    topic = np.repeat(np.arange(len(parts)), counts)
    return MessageBlock(tuple(messages), topic[order], payloads, payloads.log_time)


def empty_block() -> MessageBlock:
    """No messages."""
    return block_of((), (), payloads_of([], []), ())


def join_blocks(first: MessageBlock, second: MessageBlock) -> MessageBlock:
    """Messages of both; of equal log times, those of the first come first."""
    if not len(first):
        return second
    if not len(second):
        return first
    parts = [first.payloads, second.payloads]
    order = time_order(parts)
    names = tuple(dict.fromkeys(first.names + second.names))
    index = np.array([names.index(name) for name in second.names])
    topic = np.concatenate([first.topic, index[second.topic]])
    publish_time = np.concatenate([first.publish_time, second.publish_time])
    return MessageBlock(names, topic[order], arrange(parts, order), publish_time[order])


def merge(blocks: Iterable[tuple[int, MessageBlock]]) -> Iterator[MessageBlock]:
    """Blocks that may overlap in time as blocks that do not.

    What is in memory at a time is the blocks that overlap.

    Args:
        blocks: by rising time, ns since the epoch, before which neither the block nor those behind it have messages.
    """
    pending = empty_block()
    for start, block in blocks:
        ready, pending = pending.split(start)
        if len(ready):
            yield ready
        pending = join_blocks(pending, block)
    if len(pending):
        yield pending


def merge_into(blocks: Iterable[MessageBlock], other: MessageBlock) -> Iterator[MessageBlock]:
    """Blocks by rising log time with the messages of another one in between; of equal times, those come last."""
    done = 0
    for block in blocks:
        if not len(block):
            continue
        count = int(np.searchsorted(other.log_time, block.log_time[-1]))
        yield join_blocks(block, other.select(slice(done, count)))
        done = count
    if done < len(other):
        yield other.select(slice(done, None))
