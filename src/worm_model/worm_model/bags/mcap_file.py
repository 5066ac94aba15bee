# SPDX-License-Identifier: Apache-2.0
"""One MCAP file, read lazily, extent by extent; and several read as one."""

from __future__ import annotations

import fcntl
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

import numpy as np
from mcap.records import Attachment

from worm_model.bags.blocks import MessageBlock, block_of
from worm_model.bags.errors import BagError
from worm_model.bags.mcap_contents import MAGIC, Contents, read_contents
from worm_model.bags.mcap_records import (
    DAMAGE,
    INDEX_ENTRY,
    RECORD,
    Extent,
    RawMessage,
    gather,
    index_entries,
    read_rare,
    unwrap_chunk,
    walk_messages,
)
from worm_model.bags.payloads import Integers, Payloads, Times, groups, payloads_of

BLOCK_BYTES = 1 << 24  # of chunks that are taken apart together

Reader = Callable[[BinaryIO, int], Contents]


@contextmanager
def explained(path: Path) -> Iterator[None]:
    """Turn what the readers raise at damaged content into a BagError."""
    try:
        yield
    except BagError:
        raise
    except (*DAMAGE, OSError) as error:  # OSError: an offset that no file has
        reason = str(error) or type(error).__name__
        raise BagError(
            f"{path} is damaged ({reason}); worm_model recover saves what is whole"
        ) from None


class McapFile:
    """An MCAP file that is open for reading.

    Args:
        path: the file.
        read: finds out what is where: `read_contents` or `scan_contents`.

    Raises:
        BagError: it is missing, empty, or no MCAP file.
    """

    def __init__(self, path: Path, read: Reader = read_contents) -> None:
        self.path = path
        self._stream = _open(path)
        self.size = path.stat().st_size
        self.contents = read(self._stream, self.size)

    def close(self) -> None:
        """Close the file."""
        self._stream.close()

    def block(self, extent: Extent, names: tuple[str, ...]) -> MessageBlock:
        """The messages of some topics in one extent."""
        topics = {
            number: names.index(channel.topic)
            for number, channel in self.contents.channels.items()
            if channel.topic in names
        }
        with explained(self.path):
            records, indexes = self._read(extent)
            if extent.indexes is None:
                return _walked_block(records, names, topics)
            part = _Indexed(frozenset(topics))
            part.add(records, extent, indexes)
            return part.block(names, topics)

    def payloads(self, wanted: frozenset[int]) -> list[tuple[int, Payloads]]:
        """All messages of some channels in arrays, in pieces: with message indexes, no message is touched singly."""
        found: list[tuple[int, Payloads]] = []
        part = _Indexed(wanted)
        with explained(self.path):
            for extent in self.contents.extents:
                records, indexes = self._read(extent)
                if extent.indexes is None:
                    found += _walked_payloads(records, wanted)
                    continue
                part.add(records, extent, indexes)
                if part.size > BLOCK_BYTES:
                    found += part.payloads()
                    part = _Indexed(wanted)
            found += part.payloads()
        return found

    def _read(self, extent: Extent) -> tuple[bytes, bytes]:
        """Records of an extent, and its message indexes, which lie right behind it."""
        self._stream.seek(extent.offset)
        data = self._stream.read(extent.length + extent.indexes_length)
        if not extent.is_chunk:
            return data, b""
        return unwrap_chunk(data[RECORD.size : extent.length]), data[extent.length :]

    def attachments(self) -> Iterator[Attachment]:
        """The files kept inside."""
        for offset, length in self.contents.attachments:
            with explained(self.path):
                self._stream.seek(offset)
                data = self._stream.read(length)
                attachment = read_rare(data[0], data[RECORD.size :])
                if not isinstance(attachment, Attachment):
                    raise ValueError("an attachment is not where its index says")
            yield attachment

    def is_being_written(self) -> bool:
        """Whether a recorder holds the file at this moment."""
        try:
            fcntl.flock(self._stream, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except OSError:
            return True
        fcntl.flock(self._stream, fcntl.LOCK_UN)
        return False


def _open(path: Path) -> BinaryIO:
    try:
        stream = path.open("rb")
    except OSError as error:
        raise BagError(f"{path} cannot be read: {error.strerror}") from None
    magic = stream.read(len(MAGIC))
    if magic == MAGIC:
        return stream
    stream.close()
    if not magic:
        raise BagError(f"{path} is empty: nothing was recorded, or its disk was full")
    raise BagError(f"{path} is not an MCAP file: its first bytes are {magic!r}")


class _Indexed:
    """Chunks with message indexes that are taken apart together: numpy costs the same for one as for many."""

    def __init__(self, wanted: frozenset[int]) -> None:
        self.size = 0
        self._wanted = wanted
        self._records: list[bytes] = []
        self._parts: list[tuple[int, bytes, int, int]] = []

    def add(self, records: bytes, extent: Extent, indexes: bytes) -> None:
        """Add the records of a chunk with its message indexes."""
        begin, end = self.size, self.size + len(records)
        for channel, place in (extent.indexes or {}).items():
            if channel in self._wanted:
                entries = index_entries(indexes, place - extent.offset - extent.length, channel)
                self._parts.append((channel, entries, begin, end))
        self._records.append(records)
        self.size = end

    def payloads(self) -> list[tuple[int, Payloads]]:
        """Messages by channel."""
        channel, messages, _ = self._gather()
        return [(number, messages.select(rows).compact()) for number, rows in groups(channel)]

    def block(self, names: tuple[str, ...], topics: Mapping[int, int]) -> MessageBlock:
        """Messages by rising log time, of equal ones in the order of the file.

        Args:
            names: of topics.
            topics: index into them by channel.
        """
        channel, messages, publish_time = self._gather()
        order = np.lexsort((messages.offset, messages.log_time))
        topic = np.zeros(len(channel), np.int64)
        for number, index in topics.items():
            topic[channel == number] = index
        return MessageBlock(names, topic[order], messages.select(order), publish_time[order])

    def _gather(self) -> tuple[Integers, Payloads, Times]:
        """Channels, messages and their publish times, channel by channel."""
        records = np.frombuffer(b"".join(self._records), np.uint8)
        entries = np.frombuffer(b"".join(part for _, part, _, _ in self._parts), INDEX_ENTRY)
        places = [
            (channel, begin, end, len(part) // INDEX_ENTRY.itemsize)
            for channel, part, begin, end in self._parts
        ]
        columns = np.array(places, dtype=np.int64).reshape(-1, 4).T
        channel, begin, limit = (np.repeat(column, columns[3]) for column in columns[:3])
        offset = entries["offset"].astype(np.int64) + begin
        return channel, *gather(records, offset, limit, channel)


def _walked_payloads(records: bytes, wanted: frozenset[int]) -> list[tuple[int, Payloads]]:
    found: dict[int, list[RawMessage]] = {}
    for message in walk_messages(records, wanted):
        found.setdefault(message.channel, []).append(message)
    return [
        (channel, payloads_of([m.data for m in messages], [m.log_time for m in messages]))
        for channel, messages in found.items()
    ]


def _walked_block(
    records: bytes, names: tuple[str, ...], topics: Mapping[int, int]
) -> MessageBlock:
    found = list(walk_messages(records, frozenset(topics)))
    return block_of(
        names,
        [topics[message.channel] for message in found],
        payloads_of([m.data for m in found], [m.log_time for m in found]),
        [m.publish_time for m in found],
    )
