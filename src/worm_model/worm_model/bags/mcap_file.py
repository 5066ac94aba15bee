# SPDX-License-Identifier: Apache-2.0
"""One MCAP file, read lazily, extent by extent; and several read as one."""

from __future__ import annotations

import fcntl
from bisect import bisect_left
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

import numpy as np
from mcap.records import Attachment

from worm_model.bags.errors import BagError
from worm_model.bags.mcap_contents import MAGIC, read_contents
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
from worm_model.bags.payloads import Payloads, payloads_of

BLOCK_BYTES = 1 << 24  # of chunks that are taken apart together

SourcedMessage = tuple[int, RawMessage]


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

    Raises:
        BagError: it is missing, empty, or no MCAP file.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._stream = _open(path)
        self.size = path.stat().st_size
        self.contents = read_contents(self._stream, self.size)

    def close(self) -> None:
        """Close the file."""
        self._stream.close()

    def load(self, extent: Extent, wanted: frozenset[int]) -> list[RawMessage]:
        """The messages of some channels in one extent, by rising log time."""
        with explained(self.path):
            messages = list(walk_messages(self._read(extent)[0], wanted))
        messages.sort(key=_log_time)
        return messages

    def payloads(self, wanted: frozenset[int]) -> list[tuple[int, Payloads]]:
        """All messages of some channels in arrays, in pieces: with message indexes, no message is touched singly."""
        found: list[tuple[int, Payloads]] = []
        block = _Block(wanted)
        with explained(self.path):
            for extent in self.contents.extents:
                records, indexes = self._read(extent)
                if extent.indexes is None:
                    found += _walked_payloads(records, wanted)
                    continue
                block.add(records, extent, indexes)
                if block.size > BLOCK_BYTES:
                    found += block.payloads()
                    block = _Block(wanted)
            found += block.payloads()
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


def _log_time(message: RawMessage) -> int:
    return message.log_time


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


class _Block:
    """Chunks that are taken apart together: numpy costs the same for one as for many."""

    def __init__(self, wanted: frozenset[int]) -> None:
        self.size = 0
        self._wanted = wanted
        self._records: list[bytes] = []
        self._entries: dict[int, list[tuple[bytes, int, int]]] = {}

    def add(self, records: bytes, extent: Extent, indexes: bytes) -> None:
        """Add the records of a chunk with its message indexes."""
        begin, end = self.size, self.size + len(records)
        for channel, place in (extent.indexes or {}).items():
            if channel in self._wanted:
                entries = index_entries(indexes, place - extent.offset - extent.length, channel)
                self._entries.setdefault(channel, []).append((entries, begin, end))
        self._records.append(records)
        self.size = end

    def payloads(self) -> list[tuple[int, Payloads]]:
        """Messages by channel."""
        records = np.frombuffer(b"".join(self._records), np.uint8)
        found = []
        for channel, parts in self._entries.items():
            entries = np.frombuffer(b"".join(entries for entries, _, _ in parts), INDEX_ENTRY)
            counts = [len(part) // INDEX_ENTRY.itemsize for part, _, _ in parts]
            begin = np.repeat([begin for _, begin, _ in parts], counts)
            limit = np.repeat([end for _, _, end in parts], counts)
            offset = entries["offset"].astype(np.int64) + begin
            found.append((channel, gather(records, offset, limit, channel)))
        return found


def _walked_payloads(records: bytes, wanted: frozenset[int]) -> list[tuple[int, Payloads]]:
    found: dict[int, list[RawMessage]] = {}
    for message in walk_messages(records, wanted):
        found.setdefault(message.channel, []).append(message)
    return [
        (channel, payloads_of([m.data for m in messages], [m.log_time for m in messages]))
        for channel, messages in found.items()
    ]


def merge(sources: Sequence[tuple[McapFile, frozenset[int]]]) -> Iterator[list[SourcedMessage]]:
    """Messages of several files by rising log time, a batch at a time, each with the index of its file.

    What is in memory at a time is the extents that overlap in time, however long the files are.
    """
    extents = sorted(
        (extent.start, extent.end, index, extent)
        for index, (file, _) in enumerate(sources)
        for extent in file.contents.extents
    )
    pending: list[SourcedMessage] = []
    for start, _, index, extent in extents:
        ready = bisect_left(pending, start, key=_sourced_log_time)
        if ready:
            yield pending[:ready]
        file, wanted = sources[index]
        pending = pending[ready:] + [(index, message) for message in file.load(extent, wanted)]
        pending.sort(key=_sourced_log_time)
    if pending:
        yield pending


def _sourced_log_time(item: SourcedMessage) -> int:
    return item[1].log_time
