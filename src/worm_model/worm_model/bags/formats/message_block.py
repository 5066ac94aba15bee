# SPDX-License-Identifier: Apache-2.0
"""Single messages, and blocks that store many messages in columns, so that a replay reads half a million per second."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Bytes = NDArray[np.uint8]
Integers = NDArray[np.int64]
Times = NDArray[np.uint64]  # ns since the epoch, unsigned as in the files


@dataclass(frozen=True)
class Topic:
    """Topic of a bag with the layout of its messages, called a channel in MCAP.

    Attributes:
        name: full name.
        type_name: ``package/msg/Type``.
        count: number of messages; ignored when topics are compared.
        definition: text of the type with all types that it needs, empty if the bag has none.
        definition_format: ``ros2msg`` or ``ros2idl``.
        encoding: encoding of the messages; only ``cdr`` can be decoded.
        metadata: metadata of the channel: ``offered_qos_profiles`` (YAML) and ``topic_type_hash``.
    """

    name: str
    type_name: str
    count: int = field(compare=False)
    definition: str
    definition_format: str
    encoding: str
    metadata: tuple[tuple[str, str], ...] = ()

    @property
    def type_hash(self) -> str:
        """RIHS01 hash of the type, empty if the bag does not contain it."""
        return dict(self.metadata).get("topic_type_hash", "")

    @property
    def offered_qos(self) -> str:
        """Quality of service of the publishers, YAML; empty if the bag does not contain it."""
        return dict(self.metadata).get("offered_qos_profiles", "")


class Message(NamedTuple):
    """Encoded message. Times in ns since the epoch; `channel` describes its encoding."""

    topic: str
    log_time: int
    data: bytes
    publish_time: int
    channel: Topic


@dataclass(frozen=True)
class Messages:
    """Block of messages, each a part of a buffer.

    Attributes:
        channels: possible channels of the messages.
        buffer: shape (bytes,), contiguous.
        channel: index into `channels` of each message, shape (messages,).
        offset, size: first byte and number of bytes of each message in `buffer`, shape (messages,).
        log_time, publish_time: times of reception and sending, ns since the epoch, shape (messages,).
    """

    channels: tuple[Topic, ...]
    buffer: Bytes
    channel: Integers
    offset: Integers
    size: Integers
    log_time: Times
    publish_time: Times

    def __len__(self) -> int:
        return len(self.offset)

    def __iter__(self) -> Iterator[Message]:
        data = self.buffer.data
        columns = (column.tolist() for column in self._columns)
        for index, start, size, log_time, publish_time in zip(*columns, strict=True):
            channel = self.channels[index]
            payload = bytes(data[start : start + size])
            yield Message(channel.name, log_time, payload, publish_time, channel)

    @property
    def _columns(self) -> tuple[Any, ...]:
        return self.channel, self.offset, self.size, self.log_time, self.publish_time

    def payloads(self, rows: Integers) -> Bytes:
        """Return the bytes of some messages of the same size, shape (len(rows), size)."""
        size = int(self.size[rows[0]])
        if not size:
            return np.empty((len(rows), 0), np.uint8)
        return cells(self.buffer, size)[self.offset[rows]].view(np.uint8).reshape(-1, size)

    def select(self, rows: Integers | slice | NDArray[np.bool_]) -> Messages:
        """Return some of the messages, in the same buffer."""
        return Messages(self.channels, self.buffer, *(column[rows] for column in self._columns))

    def like(self, topic: Topic) -> Messages:
        """Return the messages with the type and the encoding of a topic."""
        kind = topic.type_name, topic.encoding
        return self.within([c for c in self.channels if (c.type_name, c.encoding) == kind])

    def within(self, channels: Collection[Topic]) -> Messages:
        """Return the messages of some channels."""
        wanted = np.array([channel in channels for channel in self.channels], bool)
        return self if wanted.all() else self.select(wanted[self.channel])

    def sorted(self) -> Messages:
        """Return the messages in order of log time; messages of equal time keep their order."""
        return self.select(np.argsort(self.log_time, kind="stable"))

    def compact(self) -> Messages:
        """Return the same messages in a buffer without other bytes."""
        start = np.cumsum(self.size) - self.size
        buffer = np.empty(int(self.size.sum()), np.uint8)
        for size, rows in groups(self.size):
            if size:
                cells(buffer, size)[start[rows]] = cells(self.buffer, size)[self.offset[rows]]
        return replace(self, buffer=buffer, offset=start)

    def by_topic(self) -> Iterator[tuple[str, Messages]]:
        """Yield the name and the messages of each topic that has messages; their layouts may differ."""
        names = list(dict.fromkeys(channel.name for channel in self.channels))
        number = np.array([names.index(channel.name) for channel in self.channels], np.int64)
        for index, rows in groups(number[self.channel]) if names else ():
            yield names[index], self.select(rows)


def cells(buffer: Bytes, size: int) -> NDArray[np.void]:
    """Return a view of all windows of ``size`` bytes in a contiguous buffer. Window i begins at byte i.

    Reading or writing a window costs one copy, a tenth of the cost of indexing each byte.
    """
    return np.ndarray(max(len(buffer) - size + 1, 0), f"V{size}", buffer, strides=(1,))


def groups(keys: NDArray[np.integer]) -> Iterator[tuple[int, Integers]]:
    """Yield the distinct keys in increasing order, each with the rows that have it, in increasing order."""
    if not len(keys):
        return
    order = np.argsort(keys, kind="stable")
    for rows in np.split(order, np.flatnonzero(np.diff(keys[order])) + 1):
        yield int(keys[rows[0]]), rows


def messages_of(messages: Sequence[Message]) -> Messages:
    """Return a block that contains the messages, in the same order."""
    channels = tuple(dict.fromkeys(message.channel for message in messages))
    index = {channel: number for number, channel in enumerate(channels)}
    size = np.array([len(message.data) for message in messages], np.int64)
    return Messages(
        channels,
        np.frombuffer(b"".join(message.data for message in messages), np.uint8),
        np.array([index[message.channel] for message in messages], np.int64),
        np.cumsum(size) - size,
        size,
        np.array([message.log_time for message in messages], np.uint64),
        np.array([message.publish_time for message in messages], np.uint64),
    )


def concatenate(parts: Sequence[Messages]) -> Messages:
    """Return one block with all messages of the blocks, in the same order."""
    if len(parts) == 1:
        return parts[0]
    files = {id(part.channels): part.channels for part in parts}  # usually one file
    channels = tuple(dict.fromkeys(channel for each in files.values() for channel in each))
    index = {channel: number for number, channel in enumerate(channels)}
    numbers = {
        key: np.array([index[channel] for channel in each], np.int64) for key, each in files.items()
    }
    start = np.cumsum([0, *(len(part.buffer) for part in parts)])
    return Messages(
        channels,
        np.concatenate([part.buffer for part in parts]),
        np.concatenate([numbers[id(part.channels)][part.channel] for part in parts]),
        np.concatenate([part.offset + at for part, at in zip(parts, start, strict=False)]),
        np.concatenate([part.size for part in parts]),
        np.concatenate([part.log_time for part in parts]),
        np.concatenate([part.publish_time for part in parts]),
    )
