# SPDX-License-Identifier: Apache-2.0
"""One MCAP file, read lazily: by its index when it has one, else by a scan that stops where the file stops.

The records' own layout is that of the `mcap` library; only the walk through the messages of a chunk is done here, in
one pass without an object per record, which is several times faster than the library's.
"""

from __future__ import annotations

import fcntl
import struct
from bisect import bisect_left
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.records import Attachment, Channel, Chunk, Header, Metadata, Schema
from mcap.stream_reader import get_chunk_data_stream

from worm_model.bags.errors import BagError
from worm_model.bags.payloads import Bytes, Payloads, payloads_of

MAGIC = b"\x89MCAP0\r\n"
PLAIN_EXTENT_BYTES = 1 << 20  # messages outside of chunks are taken in runs of about this size
MAX_CHUNK_BYTES = 1 << 31  # more than any writer makes: a damaged length, not a chunk
_RECORD = struct.Struct("<BQ")  # opcode, length
_MESSAGE = struct.Struct("<BQHIQQ")  # opcode, length, channel, sequence, log time, publish time
_HEAD = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log_time", "<u8"),
        ("publish_time", "<u8"),
    ]
)  # the same as columns
_INDEX = struct.Struct("<BQHI")  # opcode, length, channel, bytes of entries
_INDEX_ENTRY = np.dtype([("log_time", "<u8"), ("offset", "<u8")])
_DAMAGE = (
    McapError,
    struct.error,
    zstandard.ZstdError,
    RuntimeError,  # lz4's
    ValueError,
    KeyError,
    IndexError,
    OverflowError,
    MemoryError,  # a damaged length
)


class RawMessage(NamedTuple):
    """A message as it lies in the file; times in ns."""

    log_time: int
    channel: int
    data: bytes
    publish_time: int
    sequence: int


SourcedMessage = tuple[int, RawMessage]


class Extent(NamedTuple):
    """A stretch of the file that holds messages: a chunk, or a run of plain records.

    Attributes:
        start, end: least and greatest log time, ns.
        offset, length: where in the file its records lie.
        is_chunk: whether they are wrapped in one chunk record.
        indexes: where in the file the message index of each channel lies, None if there is none.
        indexes_length: bytes of all these indexes, which lie together.
    """

    start: int
    end: int
    offset: int
    length: int
    is_chunk: bool
    indexes: Mapping[int, int] | None = None
    indexes_length: int = 0


@dataclass
class Contents:
    """What an MCAP file holds, without its messages.

    Attributes:
        extents: where messages are, in the order of the file.
        counts: number of messages by channel.
        end: first byte that is not part of a whole record.
        whole: whether the file ends as a closed one does.
        attachments: where each attachment record lies: offset and length.
        damaged_chunks: number of chunks whose content is spoilt; they are left out of `extents`.
    """

    profile: str = ""
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    extents: list[Extent] = field(default_factory=list)
    counts: dict[int, int] = field(default_factory=dict)
    metadata: list[Metadata] = field(default_factory=list)
    attachments: list[tuple[int, int]] = field(default_factory=list)
    end: int = 0
    whole: bool = False
    damaged_chunks: int = 0

    @property
    def sound(self) -> bool:
        """Whether nothing of the file is known to be missing."""
        return self.whole and not self.damaged_chunks


@contextmanager
def explained(path: Path) -> Iterator[None]:
    """Turn what the libraries raise at damaged content into a BagError."""
    try:
        yield
    except BagError:
        raise
    except _DAMAGE as error:
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
        self.contents = self._indexed() or scan(self._stream)

    def close(self) -> None:
        """Close the file."""
        self._stream.close()

    def load(self, extent: Extent, wanted: frozenset[int]) -> list[RawMessage]:
        """The messages of some channels in one extent, by rising log time."""
        with explained(self.path):
            self._stream.seek(extent.offset)
            data = self._stream.read(extent.length)
            messages = list(walk_messages(_unwrap(data) if extent.is_chunk else data, wanted))
        messages.sort(key=_log_time)
        return messages

    def payloads(self, extent: Extent, wanted: frozenset[int]) -> dict[int, Payloads]:
        """As `load`, by channel and in arrays: with a message index, without an object per message."""
        with explained(self.path):
            self._stream.seek(extent.offset)
            data = self._stream.read(extent.length)
            records = _unwrap(data) if extent.is_chunk else data
            if extent.indexes is None:
                return _walked_payloads(records, wanted)
            first = min(extent.indexes.values())
            self._stream.seek(first)
            index = self._stream.read(extent.indexes_length)
            buffer = np.frombuffer(records, np.uint8)
            return {
                channel: _indexed_payloads(buffer, index, place - first, channel)
                for channel, place in extent.indexes.items()
                if channel in wanted
            }

    def attachments(self) -> Iterator[Attachment]:
        """The files kept inside."""
        for offset, length in self.contents.attachments:
            with explained(self.path):
                self._stream.seek(offset + _RECORD.size)
                data = self._stream.read(length - _RECORD.size)
                attachment = Attachment.read(ReadDataStream(BytesIO(data)))
            yield attachment

    def is_being_written(self) -> bool:
        """Whether a recorder holds the file at this moment."""
        try:
            fcntl.flock(self._stream, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except OSError:
            return True
        fcntl.flock(self._stream, fcntl.LOCK_UN)
        return False

    def _indexed(self) -> Contents | None:
        """Contents by the summary at the file's end; None if there is none that suffices."""
        try:
            return _by_summary(self._stream, self.size)
        except (*_DAMAGE, OSError):  # OSError: an offset before the file's beginning
            return None


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


def _by_summary(stream: BinaryIO, size: int) -> Contents | None:
    stream.seek(0)
    reader = SeekingReader(stream, record_size_limit=size)
    stream.seek(-len(MAGIC), 2)
    if stream.read() != MAGIC:
        return None
    summary = reader.get_summary()
    if summary is None or summary.statistics is None:
        return None
    statistics = summary.statistics
    complete = len(summary.channels) == statistics.channel_count and (
        len(summary.chunk_indexes) == statistics.chunk_count > 0 or statistics.message_count == 0
    )
    known = all(c.schema_id in summary.schemas for c in summary.channels.values() if c.schema_id)
    if not complete or not known:
        return None
    return Contents(
        profile=reader.get_header().profile,
        schemas=summary.schemas,
        channels=summary.channels,
        extents=[
            Extent(
                start=c.message_start_time,
                end=c.message_end_time,
                offset=c.chunk_start_offset,
                length=c.chunk_length,
                is_chunk=True,
                indexes=c.message_index_offsets or None,
                indexes_length=c.message_index_length,
            )
            for c in summary.chunk_indexes
        ],
        counts=dict(statistics.channel_message_counts),
        metadata=list(reader.iter_metadata()),
        attachments=[(index.offset, index.length) for index in summary.attachment_indexes],
        end=size,
        whole=True,
    )


def scan(stream: BinaryIO) -> Contents:
    """Contents by reading the file from its beginning to the first record that is not whole."""
    scanner = _Scanner(stream)
    with suppress(*_DAMAGE):  # `end` tells where: the rest of the file is lost
        scanner.run()
    scanner.close_run()
    return scanner.contents


class _Scanner:
    """Walks through the records of a file and takes note of what is where."""

    def __init__(self, stream: BinaryIO) -> None:
        self.contents = Contents(end=len(MAGIC))
        self._stream = stream
        self._size = stream.seek(0, 2)
        self._run: list[int] = []  # offset, least and greatest log time of a run of plain messages

    def run(self) -> None:
        """Walk until the end, or until a record is not whole."""
        while not self.contents.whole:
            self._stream.seek(self.contents.end)
            opcode, length = _RECORD.unpack(self._stream.read(_RECORD.size))
            if length > self._size - self._stream.tell():
                return  # cut off
            self._take(opcode, length)
            self.contents.end += _RECORD.size + length
            if opcode == Opcode.FOOTER:
                self.contents.whole = self._stream.read() == MAGIC
                return

    def close_run(self) -> None:
        """End a run of plain messages before something else."""
        if self._run:
            offset, start, end = self._run
            self.contents.extents.append(
                Extent(start, end, offset, self.contents.end - offset, is_chunk=False)
            )
            self._run = []

    def _take(self, opcode: int, length: int) -> None:
        if opcode == Opcode.MESSAGE:
            self._message(self._stream.read(length))
            return
        if opcode == Opcode.ATTACHMENT:
            self.contents.attachments.append((self.contents.end, _RECORD.size + length))
        if opcode != Opcode.FOOTER and opcode in _READERS:
            self.close_run()
            record = _READERS[opcode](ReadDataStream(BytesIO(self._stream.read(length))))
            self._keep(record, length)
        else:
            self._stream.seek(length, 1)

    def _message(self, data: bytes) -> None:
        channel, _, log_time, _ = struct.unpack_from("<HIQQ", data)
        self.contents.counts[channel] = self.contents.counts.get(channel, 0) + 1
        here = self.contents.end
        if not self._run:
            self._run = [here, log_time, log_time]
        self._run[1:] = min(log_time, self._run[1]), max(log_time, self._run[2])
        if here - self._run[0] > PLAIN_EXTENT_BYTES:
            offset, start, end = self._run
            length = here + _RECORD.size + len(data) - offset
            self.contents.extents.append(Extent(start, end, offset, length, is_chunk=False))
            self._run = []

    def _keep(self, record: object, length: int) -> None:
        contents = self.contents
        if isinstance(record, Header):
            contents.profile = record.profile
        elif isinstance(record, Schema):
            contents.schemas[record.id] = record
        elif isinstance(record, Channel):
            contents.channels[record.id] = record
        elif isinstance(record, Metadata):
            contents.metadata.append(record)
        elif isinstance(record, Chunk):
            self._chunk(record, _RECORD.size + length)

    def _chunk(self, chunk: Chunk, length: int) -> None:
        try:
            data = _decompress(chunk)
            registered = _registrations(data)
            times = [(m.log_time, m.channel) for m in walk_messages(data, None)]
        except _DAMAGE:
            self.contents.damaged_chunks += 1
            return
        for record in registered:
            self._keep(record, 0)
        for _, channel in times:
            self.contents.counts[channel] = self.contents.counts.get(channel, 0) + 1
        if times:
            extent = Extent(min(times)[0], max(times)[0], self.contents.end, length, is_chunk=True)
            self.contents.extents.append(extent)


_READERS: dict[int, Callable[[ReadDataStream], object]] = {
    Opcode.HEADER: Header.read,
    Opcode.SCHEMA: Schema.read,
    Opcode.CHANNEL: Channel.read,
    Opcode.METADATA: Metadata.read,
    Opcode.CHUNK: Chunk.read,
}


def _unwrap(record: bytes) -> bytes:
    """Records inside a whole chunk record."""
    return _decompress(Chunk.read(ReadDataStream(BytesIO(record[_RECORD.size :]))))


def _decompress(chunk: Chunk) -> bytes:
    """Records inside a chunk; raises one of `_DAMAGE` if they are not what was written."""
    if chunk.uncompressed_size > MAX_CHUNK_BYTES:
        raise ValueError(f"a chunk claims {chunk.uncompressed_size} bytes")
    stream, length = get_chunk_data_stream(chunk, validate_crc=True)
    if length != chunk.uncompressed_size:
        raise ValueError(f"a chunk holds {length} bytes instead of {chunk.uncompressed_size}")
    return stream.read(length)


def _registrations(data: bytes) -> list[object]:
    """Schemas and channels among records."""
    found = []
    position = 0
    while position < len(data):
        opcode, length = _RECORD.unpack_from(data, position)
        start = position + _RECORD.size
        if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            found.append(_READERS[opcode](ReadDataStream(BytesIO(data[start : start + length]))))
        position = start + length
    return found


def _walked_payloads(records: bytes, wanted: frozenset[int]) -> dict[int, Payloads]:
    found: dict[int, list[RawMessage]] = {}
    for message in walk_messages(records, wanted):
        found.setdefault(message.channel, []).append(message)
    return {
        channel: payloads_of([m.data for m in messages], [m.log_time for m in messages])
        for channel, messages in found.items()
    }


def _indexed_payloads(records: Bytes, index: bytes, place: int, channel: int) -> Payloads:
    """Messages of a channel by its message index.

    Raises:
        ValueError, struct.error: the index does not fit the records.
    """
    opcode, _, owner, size = _INDEX.unpack_from(index, place)
    start = place + _INDEX.size
    if opcode != Opcode.MESSAGE_INDEX or owner != channel or start + size > len(index):
        raise ValueError("a message index is not where it should be")
    entries = np.frombuffer(index, _INDEX_ENTRY, size // _INDEX_ENTRY.itemsize, start)
    offset = entries["offset"].astype(np.int64)
    if offset.size and not 0 <= offset.min() <= offset.max() <= len(records) - _MESSAGE.size:
        raise ValueError("a message index points out of its chunk")
    heads = records[offset[:, np.newaxis] + np.arange(_MESSAGE.size)].reshape(-1).view(_HEAD)
    size_of = heads["length"].astype(np.int64) - (_MESSAGE.size - _RECORD.size)
    fits = (heads["opcode"] == Opcode.MESSAGE) & (heads["channel"] == channel) & (size_of >= 0)
    if not (fits & (offset + _MESSAGE.size + size_of <= len(records))).all():
        raise ValueError("a message index points to something else")
    log_time = heads["log_time"].astype(np.int64)
    return Payloads(records, offset + _MESSAGE.size, size_of, log_time).compact()


def walk_messages(data: bytes, wanted: frozenset[int] | None) -> Iterator[RawMessage]:
    """Messages of some channels (None: of all) among records, in their order.

    Raises:
        ValueError, struct.error: the records are damaged.
    """
    unpack, head, size = _MESSAGE.unpack_from, _RECORD.unpack_from, len(data)
    position = 0
    while position < size:
        opcode, length = head(data, position)
        end = position + 9 + length
        if end > size:
            raise ValueError("a record is longer than what holds it")
        if opcode == 5:
            _, _, channel, sequence, log_time, publish_time = unpack(data, position)
            if length < 22:
                raise ValueError("a message is shorter than its head")
            if wanted is None or channel in wanted:
                yield RawMessage(
                    log_time, channel, data[position + 31 : end], publish_time, sequence
                )
        position = end


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
