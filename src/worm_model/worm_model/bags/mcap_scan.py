# SPDX-License-Identifier: Apache-2.0
"""What an MCAP file holds, by a walk over its records: its data section decides, its summary is compared with it.

A walk over the heads of records costs a microsecond each, and there is a chunk of them every half second or megabyte.
Where a record is broken, the walk goes on at the next one that the index of the summary names or, without one, that
stands the test of its checksum and of what follows it (https://mcap.dev/spec).
"""

from __future__ import annotations

import re
import struct
import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from io import BytesIO
from typing import NamedTuple

import lz4.frame
import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    ChunkIndex,
    Header,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)
from numpy.typing import NDArray

Buffer = memoryview
MAGIC = b"\x89MCAP0\r\n"
RECORD = struct.Struct("<BQ")  # opcode, length
HEAD = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log_time", "<u8"),
        ("publish_time", "<u8"),
    ]
)  # of a message
MESSAGE_BODY = HEAD.itemsize - RECORD.size  # before the payload
RUN_BYTES = 1 << 20  # messages outside of chunks are taken together in runs of about this size
LARGEST_CHUNK = 1 << 31  # more than any writer makes: a damaged length
LARGEST_OPCODE = 0x0F
FIRST_PRIVATE_OPCODE = 0x80
_CHUNK = struct.Struct("<QQQII")  # first and last log time, size, checksum, length of compression
_INDEX = struct.Struct("<HI")  # channel, bytes of entries
_ENTRY_BYTES = 16
_FOOTER = struct.Struct("<BQQQI")  # opcode, length, start of the summary, of its offsets, checksum
_ZSTD = zstandard.ZstdDecompressor()
_CHUNK_LEVEL = frozenset({Opcode.CHUNK, Opcode.ATTACHMENT, Opcode.METADATA, Opcode.DATA_END})
_PLAIN_LEVEL = _CHUNK_LEVEL | {Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE}
_LIKE_A_RECORD = re.compile(rb"(?s)(?=[\x03-\x0f].{5}\0\0\0)")  # of less than a terabyte

DAMAGE = (
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
"""What the readers of records raise when these are not what was written."""


class Extent(NamedTuple):
    """A part of the file that holds messages: a chunk, or a run of plain records.

    Attributes:
        start, end: least and greatest log time, ns.
        first, last: where in the file it lies, the last byte exclusive.
        counts: messages by channel according to the indexes behind a chunk; None without them.
    """

    start: int
    end: int
    first: int
    last: int
    counts: dict[int, int] | None = None


class Loss(NamedTuple):
    """A part of the file that is not what was written.

    Attributes:
        start, end: log times between which messages are missing, ns; 0: before the first, or after the last.
        size: bytes.
        counts: lost messages by channel; None where nothing tells.
    """

    start: int
    end: int
    size: int
    counts: dict[int, int] | None


@dataclass
class Contents:
    """What an MCAP file holds, without its messages.

    Attributes:
        counts: number of messages by channel.
        extents: where messages are, in the order of the file.
        attachments: where the body of each attachment lies: first and last byte.
        losses: parts that are spoilt, in the order of the file, but for its end.
        end: first byte that is not part of a whole record.
        whole: whether the file ends as a closed one does.
        complaints: in what its summary contradicts its data; the data is what is read.
        expected: number of messages by channel according to the summary, if that is what was written.
    """

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    counts: Counter[int] = field(default_factory=Counter)
    extents: list[Extent] = field(default_factory=list)
    metadata: list[Metadata] = field(default_factory=list)
    attachments: list[tuple[int, int]] = field(default_factory=list)
    losses: list[Loss] = field(default_factory=list)
    end: int = len(MAGIC)
    whole: bool = False
    complaints: list[str] = field(default_factory=list)
    expected: dict[int, int] | None = None

    @property
    def sound(self) -> bool:
        """Whether nothing of the file is known to be missing."""
        return self.whole and not self.losses

    def register(self, record: object) -> None:
        """Take note of a schema, a channel or a metadata record.

        Raises:
            ValueError: a number is given to two different ones.
        """
        if isinstance(record, Metadata):
            self.metadata.append(record)
        elif isinstance(record, Schema):
            if self.schemas.setdefault(record.id, record) != record:
                raise ValueError(f"schema {record.id} is defined twice")
        elif isinstance(record, Channel) and self.channels.setdefault(record.id, record) != record:
            raise ValueError(f"channel {record.id} is defined twice")


# --- records --------------------------------------------------------------------------------------

_READERS: dict[int, Callable[[ReadDataStream], object]] = {
    Opcode.HEADER: Header.read,
    Opcode.SCHEMA: Schema.read,
    Opcode.CHANNEL: Channel.read,
    Opcode.METADATA: Metadata.read,
    Opcode.ATTACHMENT: Attachment.read,
    Opcode.STATISTICS: Statistics.read,
    Opcode.CHUNK_INDEX: ChunkIndex.read,
    Opcode.ATTACHMENT_INDEX: AttachmentIndex.read,
    Opcode.METADATA_INDEX: MetadataIndex.read,
}


def read_record(opcode: int, body: bytes | memoryview) -> object | None:
    """The `mcap` library's object of a record that there are few of; None for any other.

    Raises:
        one of DAMAGE: the record is not what was written.
    """
    reader = _READERS.get(opcode)
    return None if reader is None else reader(ReadDataStream(BytesIO(body)))


def read_attachment(data: Buffer, place: tuple[int, int]) -> Attachment:
    """A file that is kept inside, its checksum compared; raises one of DAMAGE."""
    body = data[place[0] : place[1]]
    (checksum,) = struct.unpack("<I", body[-4:])
    if checksum and zlib.crc32(body[:-4]) != checksum:
        raise ValueError("the checksum of an attachment is wrong")
    attachment = read_record(Opcode.ATTACHMENT, body)
    assert isinstance(attachment, Attachment)
    return attachment


def walk_records(data: bytes | memoryview) -> Iterator[tuple[int, int, int]]:
    """Opcode, and first and last byte (exclusive) of the body, of each of some records.

    Raises:
        ValueError, struct.error: the records are damaged.
    """
    unpack, size = RECORD.unpack_from, len(data)
    position = 0
    while position < size:
        opcode, length = unpack(data, position)
        start = position + RECORD.size
        position = start + length
        if position > size:
            raise ValueError("a record is longer than what holds it")
        yield opcode, start, position


def message_heads(records: bytes | memoryview) -> tuple[NDArray[np.int64], NDArray[np.void]]:
    """First bytes and heads of the messages among records, shape (messages,); raises one of DAMAGE."""
    wanted = Opcode.MESSAGE.value
    starts = [start for opcode, start, _ in walk_records(records) if opcode == wanted]
    offset = np.array(starts, np.int64) - RECORD.size
    if len(offset) and offset[-1] > len(records) - HEAD.itemsize:
        raise ValueError("a message is shorter than its head")
    cells = np.ndarray(max(len(records) - HEAD.itemsize + 1, 0), "V31", records, strides=(1,))
    heads = cells[offset].view(HEAD)
    if (heads["length"] < MESSAGE_BODY).any():
        raise ValueError("a message is shorter than its head")
    return offset, heads


def registered(records: bytes | memoryview) -> Iterator[object]:
    """Schemas and channels among records."""
    for opcode, first, last in walk_records(records):
        if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            yield read_record(opcode, records[first:last])


def _chunk_fields(body: Buffer) -> tuple[int, int, int, int, bytes, int, int]:
    """First and last log time, size, checksum, compression, and where its records begin and end in the body."""
    start, end, size, checksum, name_length = _CHUNK.unpack_from(body)
    first = _CHUNK.size + name_length + 8
    name = bytes(body[_CHUNK.size : first - 8])
    (length,) = struct.unpack_from("<Q", body, first - 8)
    if size > LARGEST_CHUNK or name not in (b"", b"zstd", b"lz4"):
        raise ValueError("this is no chunk")
    return start, end, size, checksum, name, first, first + length


def unwrap_chunk(body: Buffer) -> bytes | memoryview:
    """Records inside a chunk; raises one of DAMAGE if they are not what was written."""
    _, _, size, checksum, name, first, last = _chunk_fields(body)
    if last != len(body):
        raise ValueError("a chunk has a wrong size")
    data = _decompress(name, body[first:], size)
    if len(data) != size:
        raise ValueError(f"a chunk holds {len(data)} bytes instead of {size}")
    if checksum and zlib.crc32(data) != checksum:
        raise ValueError("the checksum of a chunk is wrong")
    return data


def _decompress(name: bytes, data: Buffer, size: int) -> bytes | memoryview:
    if name == b"zstd":
        return _ZSTD.decompress(data, max_output_size=size)
    if name == b"lz4":
        plain: bytes = lz4.frame.decompress(data)
        return plain
    return data


def extent_records(data: Buffer, extent: Extent) -> bytes | memoryview:
    """Records of an extent, taken out of their chunk; raises one of DAMAGE."""
    if data[extent.first] == Opcode.CHUNK:
        return unwrap_chunk(data[extent.first + RECORD.size : extent.last])
    return data[extent.first : extent.last]


# --- the file -------------------------------------------------------------------------------------


def scan(data: Buffer) -> Contents:
    """What a file holds that begins with MAGIC."""
    summary, complaint = _read_summary(data)
    contents = _Walk(data, summary.places if summary else []).run()
    if complaint and contents.whole:
        contents.complaints.append(complaint)
    if contents.whole and (appended := _appended(data, contents.end)):
        contents.complaints.append(
            f"behind its end lie {appended} bytes of something else, such as another bag's file, which are not read"
        )
    if summary is not None:
        contents.expected = dict(summary.statistics.channel_message_counts)
    if summary is not None and contents.sound:
        contents.complaints += _contradictions(contents, summary)
    if summary is not None and contents.sound and not contents.complaints and summary.tells_all:
        for record in summary.registered:
            contents.register(record)
        contents.counts = Counter(summary.statistics.channel_message_counts)
    else:
        _look_into_extents(data, contents)
    return contents


def _appended(data: Buffer, end: int) -> int:
    """Number of bytes behind the first footer and its MAGIC; `end`: of the data section."""
    try:
        for opcode, _, last in walk_records(data[end : len(data) - len(MAGIC)]):
            if opcode == Opcode.FOOTER:
                return len(data) - end - last - len(MAGIC)
    except DAMAGE:
        return 0  # the summary is spoilt, of which others tell
    return 0


def verify(data: Buffer, contents: Contents) -> None:
    """Look into every chunk: one that is spoilt becomes a loss, and what is lost is counted."""
    _look_into_extents(data, contents)
    _count_losses(contents)


def _look_into_extents(data: Buffer, contents: Contents) -> None:
    """Schemas, channels and numbers of messages, by what is inside the chunks."""
    contents.counts = Counter()
    sound = []
    for extent in contents.extents:
        try:
            records = extent_records(data, extent)
            for record in registered(records):
                contents.register(record)
            _, heads = message_heads(records)
        except DAMAGE:
            size = extent.last - extent.first
            contents.losses.append(Loss(extent.start, extent.end, size, extent.counts))
            continue
        contents.counts.update(heads["channel"].tolist())
        times = heads["log_time"]
        if len(times):  # the chunk's own times have no checksum
            counts = extent.counts
            start, end = int(times.min()), int(times.max())
            sound.append(Extent(start, end, extent.first, extent.last, counts))
    contents.extents = sound


def _count_losses(contents: Contents) -> None:
    """Give every loss a number by channel where the summary tells how many messages there were in all."""
    if contents.expected is None or not contents.losses:
        return
    missing = Counter(contents.expected)
    missing.subtract(contents.counts)
    known: Counter[int] = Counter()
    for loss in contents.losses:
        known.update(loss.counts or {})
    rest = {c: n - known[c] for c, n in missing.items() if n > known[c]}
    unknown = [i for i, loss in enumerate(contents.losses) if loss.counts is None]
    for place, index in enumerate(unknown):
        counts = rest if place == 0 else {}
        contents.losses[index] = contents.losses[index]._replace(counts=counts)


class _Summary:
    """The part behind the data: copies of schemas and channels, numbers, and where everything is."""

    def __init__(self, records: Sequence[object], statistics: Statistics) -> None:
        self.statistics = statistics
        self.registered = [r for r in records if isinstance(r, Schema | Channel)]
        self.chunks = {
            r.chunk_start_offset: (r.chunk_length, r.message_start_time, r.message_end_time)
            for r in records
            if isinstance(r, ChunkIndex)
        }
        others = [r.offset for r in records if isinstance(r, AttachmentIndex | MetadataIndex)]
        self.places = sorted([*self.chunks, *others])

    @property
    def tells_all(self) -> bool:
        """Whether it repeats what reading needs."""
        schemas = {record.id for record in self.registered if isinstance(record, Schema)}
        channels = [record for record in self.registered if isinstance(record, Channel)]
        return (
            len(channels) == self.statistics.channel_count
            and all(not c.schema_id or c.schema_id in schemas for c in channels)
            and set(self.statistics.channel_message_counts) <= {c.id for c in channels}
        )


def _read_summary(data: Buffer) -> tuple[_Summary | None, str]:
    """The summary if it is there and what was written, else None and, if something is wrong with it, what."""
    tail = bytes(data[-_FOOTER.size - len(MAGIC) :])
    if len(tail) < _FOOTER.size + len(MAGIC) or tail[_FOOTER.size :] != MAGIC:
        return None, ""
    opcode, _, start, _, checksum = _FOOTER.unpack_from(tail)
    if opcode != Opcode.FOOTER:
        return None, "its footer is spoilt; what it holds was read from its data"
    summary = data[start : len(data) - len(tail)] if start else data[:0]
    if checksum and zlib.crc32(tail[: _FOOTER.size - 4], zlib.crc32(summary)) != checksum:
        return None, "the checksum of its summary is wrong; what it holds was read from its data"
    try:
        records = [read_record(o, summary[a:b]) for o, a, b in walk_records(summary)]
    except DAMAGE:
        return None, "its summary is spoilt; what it holds was read from its data"
    statistics = next((record for record in records if isinstance(record, Statistics)), None)
    return (None if statistics is None else _Summary(records, statistics)), ""


def _contradictions(contents: Contents, summary: _Summary) -> Iterator[str]:
    """In what the summary differs from the data section."""
    statistics, extents = summary.statistics, contents.extents
    if statistics.chunk_count and len(extents) != statistics.chunk_count:
        yield (
            f"its summary tells of {statistics.chunk_count} chunks, its data holds {len(extents)}"
        )
    if all(extent.counts is not None for extent in extents):
        counts: Counter[int] = Counter()
        for extent in extents:
            counts.update(extent.counts or {})
        if counts != Counter(statistics.channel_message_counts):
            yield (
                f"its summary tells of {statistics.message_count} messages, "
                f"the indexes in its data of {counts.total()}"
            )
    places = {e.first: (e.last - e.first, e.start, e.end) for e in extents}
    if summary.chunks and places != summary.chunks:
        yield "the index in its summary does not lead to its chunks"
    for record in summary.registered:
        known = contents.schemas if isinstance(record, Schema) else contents.channels
        if known.get(record.id, record) != record:
            yield "its summary and its data have different topics or types"


class _Walk:
    """A walk over the records of the data section."""

    def __init__(self, data: Buffer, places: Sequence[int]) -> None:
        self.contents = Contents()
        self._data = data
        self._size = len(data)
        self._known = places  # of records, by the summary
        self._run: list[int] = []  # first byte, least and greatest log time of plain messages
        self._plain = False  # whether messages lie outside of chunks
        self._ended = False

    def run(self) -> Contents:
        """Walk until the data section ends, or the file."""
        contents = self.contents
        while contents.end < self._size:
            last = self._take(contents.end)
            if last is None:
                self._close_run()
                last = self._next_sound(contents.end)
                if last is None:
                    break
                self._lose(contents.end, last)
            contents.end = last
            if self._ended:
                contents.whole = bytes(self._data[-len(MAGIC) :]) == MAGIC
                break
        self._close_run()
        return contents

    def _lose(self, first: int, last: int) -> None:
        start = max((e.end for e in self.contents.extents), default=0)
        self.contents.losses.append(Loss(start, 0, last - first, None))

    def _take(self, place: int) -> int | None:
        """Take note of the record at a place; where it ends, or None if it is broken."""
        if place + RECORD.size > self._size:
            return None
        opcode, length = RECORD.unpack_from(self._data, place)
        first, last = place + RECORD.size, place + RECORD.size + length
        if opcode != Opcode.CHUNK and last <= self._size:
            try:
                self._keep(opcode, place, first, last)
                return last
            except DAMAGE:
                pass
        return self._chunk(place)

    def _keep(self, opcode: int, place: int, first: int, last: int) -> None:
        body = self._data[first:last]
        if opcode == Opcode.MESSAGE:
            self._message(place, last)
            return
        if opcode == Opcode.MESSAGE_INDEX:
            self._index(body)
            return
        self._close_run()
        if opcode == Opcode.ATTACHMENT:
            self.contents.attachments.append((first, last))
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.METADATA):
            self._plain |= opcode != Opcode.METADATA
            self.contents.register(read_record(opcode, body))
        elif opcode == Opcode.HEADER:
            read_record(opcode, body)
        elif opcode == Opcode.DATA_END:
            (checksum,) = struct.unpack("<I", body)
            self._ended = True
            if checksum and zlib.crc32(self._data[:place]) != checksum:
                self.contents.complaints.append("the checksum of its data is wrong")
        elif opcode < FIRST_PRIVATE_OPCODE:
            raise ValueError("a record does not belong into the data")

    def _message(self, place: int, last: int) -> None:
        channel, _, log_time, _ = struct.unpack_from("<HIQQ", self._data, place + RECORD.size)
        if last - place < HEAD.itemsize or channel not in self.contents.channels:
            raise ValueError("this is no message")
        self._plain = True
        if self._run and place - self._run[0] > RUN_BYTES:
            self._close_run()
        if not self._run:
            self._run = [place, log_time, log_time]
        self._run[1:] = min(log_time, self._run[1]), max(log_time, self._run[2])

    def _close_run(self) -> None:
        """End a run of plain messages before something else."""
        if self._run:
            first, start, end = self._run
            self.contents.extents.append(Extent(start, end, first, self.contents.end))
            self._run = []

    def _chunk(self, place: int) -> int | None:
        """Where a chunk ends, by its own length if that of its record is broken and its checksum holds."""
        self._close_run()
        first = place + RECORD.size
        opcode, length = RECORD.unpack_from(self._data, place)
        try:
            start, end, _, checksum, _, _, size = _chunk_fields(self._data[first:])
            last = first + size
            if last > self._size:
                return None
            if opcode != Opcode.CHUNK or length != size:
                if not checksum:
                    return None
                unwrap_chunk(self._data[first:last])
        except DAMAGE:
            return None
        self.contents.extents.append(Extent(start, end, place, last))
        return last

    def _index(self, body: Buffer) -> None:
        channel, size = _INDEX.unpack_from(body)
        if size != len(body) - _INDEX.size or size % _ENTRY_BYTES or not self.contents.extents:
            raise ValueError("this is no message index")
        extent = self.contents.extents[-1]
        counts = dict(extent.counts or {})
        if channel in counts:
            raise ValueError("a chunk has two indexes of a channel")
        counts[channel] = size // _ENTRY_BYTES
        self.contents.extents[-1] = extent._replace(counts=counts)

    def _next_sound(self, broken: int) -> int | None:
        """Where the next record begins that is beyond doubt."""
        known = next((place for place in self._known if place > broken), None)
        if known is not None and self._is_sound(known, _CHUNK_LEVEL):
            return known
        for level in (_CHUNK_LEVEL, _PLAIN_LEVEL):
            if level is _PLAIN_LEVEL and not self._plain:
                break
            for match in _LIKE_A_RECORD.finditer(self._data, broken + 1):
                if self._is_sound(match.start(), level):
                    return match.start()
        return None

    def _is_sound(self, place: int, level: frozenset[int]) -> bool:
        """Whether there is a record whose content and successor are what they should be."""
        opcode, length = RECORD.unpack_from(self._data, place)
        first, last = place + RECORD.size, place + RECORD.size + length
        if opcode not in level or last > self._size:
            return False
        body = self._data[first:last]
        try:
            if opcode == Opcode.CHUNK:
                return sum(1 for _ in walk_records(unwrap_chunk(body))) > 0
            if opcode == Opcode.ATTACHMENT:
                return bool(read_attachment(self._data, (first, last)))
            if opcode == Opcode.DATA_END:
                return length == 4 and self._data[last] in range(0x02, LARGEST_OPCODE + 1)
            if opcode == Opcode.MESSAGE:
                channel = struct.unpack_from("<H", body)[0]
                if length < MESSAGE_BODY or channel not in self.contents.channels:
                    return False
            else:
                read_record(opcode, body)
            return last + RECORD.size <= self._size and 0 < self._data[last] <= LARGEST_OPCODE
        except DAMAGE:
            return False
