# SPDX-License-Identifier: Apache-2.0
"""One MCAP file, read lazily, extent by extent; and several read as one."""

from __future__ import annotations

import fcntl
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

import numpy as np
from mcap.records import Attachment

from worm_model.bags.bag_errors import BagError
from worm_model.bags.blocks import MessageBlock, block_of
from worm_model.bags.mcap_contents import MAGIC, Contents, read_contents
from worm_model.bags.mcap_records import (
    DAMAGE,
    INDEX_ENTRY,
    RECORD,
    Extent,
    gather,
    index_entries,
    read_rare,
    unwrap_chunk,
    walk_messages,
)
from worm_model.bags.payloads import Integers, Payloads, Times, groups, payloads_of

BLOCK_BYTES = 1 << 24  # of chunks that are taken apart together
TOGETHER_BYTES = 1 << 20  # the same of those that are read lazily

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

    def blocks(
        self, extents: Iterable[Extent], names: tuple[str, ...]
    ) -> Iterator[tuple[int, MessageBlock]]:
        """Messages of some topics in some extents by rising start, each block with its start (ns).

        Small extents that follow each other are one block: a recorder that synchronises often leaves many.
        """
        topics = self._topics(names)
        start, part = 0, _Indexed(names, topics)
        with explained(self.path):
            for extent in extents:
                records, indexes = self._read(extent)
                alone = extent.indexes is None
                if part.size and (alone or part.size + len(records) > TOGETHER_BYTES):
                    yield start, part.block()
                    part = _Indexed(names, topics)
                if alone:
                    yield extent.start, _walked_block(records, names, topics)
                    continue
                start = start if part.size else extent.start
                part.add(records, extent, indexes)
            if part.size:
                yield start, part.block()

    def payloads(self, names: tuple[str, ...]) -> list[tuple[str, Payloads]]:
        """All messages of some topics, in pieces: with message indexes, no message is touched singly."""
        found: list[tuple[str, Payloads]] = []
        topics = self._topics(names)
        part = _Indexed(names, topics)
        with explained(self.path):
            for extent in self.contents.extents:
                records, indexes = self._read(extent)
                if extent.indexes is None:
                    walked = _walked_block(records, names, topics)
                    found += [(name, rows.compact()) for name, rows in walked.by_topic()]
                    continue
                part.add(records, extent, indexes)
                if part.size > BLOCK_BYTES:
                    found += part.payloads()
                    part = _Indexed(names, topics)
            found += part.payloads()
        return found

    def _topics(self, names: tuple[str, ...]) -> dict[int, int]:
        """Index into some topics' names by channel, of the channels that are theirs."""
        return {
            number: names.index(channel.topic)
            for number, channel in self.contents.channels.items()
            if channel.topic in names
        }

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

    def __init__(self, names: tuple[str, ...], topics: Mapping[int, int]) -> None:
        self.size = 0
        self._names = names
        self._topics = topics
        self._records: list[bytes] = []
        self._parts: list[tuple[int, bytes, int, int]] = []

    def add(self, records: bytes, extent: Extent, indexes: bytes) -> None:
        """Add the records of a chunk with its message indexes."""
        begin, end = self.size, self.size + len(records)
        for channel, place in (extent.indexes or {}).items():
            if channel in self._topics:
                entries = index_entries(indexes, place - extent.offset - extent.length, channel)
                self._parts.append((channel, entries, begin, end))
        self._records.append(records)
        self.size = end

    def payloads(self) -> list[tuple[str, Payloads]]:
        """Messages by topic."""
        topic, messages, _ = self._gather()
        return [
            (self._names[index], messages.select(rows).compact()) for index, rows in groups(topic)
        ]

    def block(self) -> MessageBlock:
        """Messages by rising log time, of equal ones in the order of the file."""
        topic, messages, publish_time = self._gather()
        order = np.lexsort((messages.offset, messages.log_time))
        return MessageBlock(self._names, topic[order], messages.select(order), publish_time[order])

    def _gather(self) -> tuple[Integers, Payloads, Times]:
        """Topics (indexes into the names), messages and their publish times, channel by channel."""
        records = np.frombuffer(b"".join(self._records), np.uint8)
        entries = np.frombuffer(b"".join(part for _, part, _, _ in self._parts), INDEX_ENTRY)
        places = [
            (channel, self._topics[channel], begin, end, len(part) // INDEX_ENTRY.itemsize)
            for channel, part, begin, end in self._parts
        ]
        columns = np.array(places, dtype=np.int64).reshape(-1, 5).T
        channel, topic, begin, limit = (np.repeat(column, columns[4]) for column in columns[:4])
        offset = entries["offset"].astype(np.int64) + begin
        return topic, *gather(records, offset, limit, channel)


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
