# SPDX-License-Identifier: Apache-2.0
"""MCAP files (https://mcap.dev/spec), open for reading.

Opening a file surveys its records in their order. Records of kinds that the specification reserves are skipped, and so
are additional fields at the end of a record, as later versions of the format may have them. A chunk that does not
decompress, fails its checksum, or declares more than LARGEST_CHUNK bytes is skipped. Where the sequence of records is
broken, reading continues at the next intact chunk; if there is none, the file ends there, as at a cut.
"""

from __future__ import annotations

import mmap
import re
import struct
import zlib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import lz4.frame
import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Metadata, Schema, Statistics
from numpy.typing import NDArray

from worm_model.bags.formats.bag_errors import BagError
from worm_model.bags.formats.bag_metadata import named_qos
from worm_model.bags.formats.message_block import Messages, Topic
from worm_model.bags.formats.stored_file import (
    AttachedFile,
    Extent,
    MetadataRecord,
    StoredFile,
    opened,
    spans_of,
)

Buffer = memoryview | bytes
MAGIC = b"\x89MCAP0\r\n"
LARGEST_CHUNK = 256 << 20  # decompressed bytes; writers make chunks of about a megabyte
# largest size (bytes) of a block of several extents; fewer blocks need fewer calls of numpy
TOGETHER_BYTES = 1 << 20
DAMAGE = (
    McapError,
    struct.error,
    zstandard.ZstdError,
    RuntimeError,  # raised by lz4
    ValueError,
    OverflowError,
    MemoryError,  # for a damaged length
)
"""Exceptions for damaged content."""

_RECORD = struct.Struct("<BQ")  # opcode, length
_LONGEST = 1 << 40  # bytes; a longer record does not exist
_HEAD = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log_time", "<u8"),
        ("publish_time", "<u8"),
    ]
)  # head of a message record
_MESSAGE_BODY = _HEAD.itemsize - _RECORD.size  # bytes before the payload
# first and last log time, size, checksum, length of the name of the compression algorithm
_CHUNK = struct.Struct("<QQQII")
# beginning of the record of a chunk; the length of the name of its compression algorithm precedes the name
_BEGINNING = re.compile(rb"(?s)\x06(?=.{36}(?:\0{4}|\x04\0{3}zstd|\x03\0{3}lz4))")
_BEGINNING_BYTES = 45
_CONTAINERS = (Opcode.ATTACHMENT, Opcode.MESSAGE)  # may contain any bytes
_FOOTER = struct.Struct("<QQI")  # start of the summary, start of the summary's offsets, checksum
_MESSAGE = Opcode.MESSAGE.value
_READERS: dict[int, Callable[[ReadDataStream], Any]] = {
    Opcode.SCHEMA: Schema.read,
    Opcode.CHANNEL: Channel.read,
    Opcode.METADATA: Metadata.read,
    Opcode.STATISTICS: Statistics.read,
}


class McapFile(StoredFile):
    """MCAP file. Opening it reads every record once.

    Raises BagError if the file is empty or not an MCAP file.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._stream = opened(path)
        try:
            self._map = mmap.mmap(self._stream.fileno(), 0, access=mmap.ACCESS_READ)
        except ValueError:
            self._stream.close()
            raise BagError(f"{path} is empty: nothing was recorded, or its disk was full") from None
        self._data = memoryview(self._map)
        if self._data[: len(MAGIC)] != MAGIC:
            beginning = bytes(self._data[: len(MAGIC)])
            self.close()
            raise BagError(f"{path} is not an MCAP file: it begins with {beginning!r}")
        survey = _Survey(self._data)
        self.counts, self.extents, self.spans = survey.counts, survey.extents, survey.spans
        self.metadata, self.damage, self.remarks = survey.metadata, survey.damage, survey.remarks
        self._attachments = survey.attachments
        self.channels = {
            number: _topic(channel, survey.schemas.get(channel.schema_id))
            for number, channel in sorted(survey.channels.items())
        }

    def blocks(
        self, extents: Iterable[Extent], topics: frozenset[str]
    ) -> Iterator[tuple[int, Messages]]:
        """Yield (start in ns, block) for the messages of some topics in extents that are in order of start.

        Consecutive small extents form one block, because a recorder that often synchronises writes many small
        chunks.
        """
        parts: list[Buffer] = []
        start, size = 0, 0
        for extent in extents:
            records = _extent_records(self._data, extent)
            if parts and size + len(records) > TOGETHER_BYTES:
                yield start, self._messages(parts, topics)
                parts, size = [], 0
            start = start if parts else extent.start
            parts.append(records)
            size += len(records)
        if parts:
            yield start, self._messages(parts, topics)

    def _messages(self, parts: Sequence[Buffer], topics: frozenset[str]) -> Messages:
        """Return messages of some topics in the order of the file."""
        records = b"".join(parts) if len(parts) > 1 else parts[0]
        offset, heads, _ = _sorted_out(records)
        lookup = np.full(1 << 16, -1)
        for row, (number, topic) in enumerate(self.channels.items()):
            lookup[number] = row if topic.name in topics else -1
        channel = lookup[heads["channel"].astype(np.int64)]
        rows = np.flatnonzero(channel >= 0)
        return Messages(
            tuple(self.channels.values()),
            np.frombuffer(records, np.uint8),
            channel[rows],
            offset[rows] + _HEAD.itemsize,
            heads["length"][rows].astype(np.int64) - _MESSAGE_BODY,
            heads["log_time"][rows].astype(np.uint64),
            heads["publish_time"][rows].astype(np.uint64),
        )

    def attachments(self) -> Iterator[AttachedFile]:
        """Yield the attached files."""
        for first, last in self._attachments:
            attached = Attachment.read(_Fields(self._data[first:last]))
            yield AttachedFile(attached.name, attached.media_type, attached.data)

    def close(self) -> None:
        """Close the file; arrays that were read from it stay valid."""
        with suppress(BufferError):  # while arrays refer to the map, it stays open
            self._data.release()
            self._map.close()
        self._stream.close()


def _topic(channel: Channel, schema: Schema | None) -> Topic:
    return Topic(
        name=channel.topic,
        type_name=schema.name if schema else "",
        count=0,
        definition=schema.data.decode(errors="replace") if schema else "",
        definition_format=schema.encoding if schema else "",
        encoding=channel.message_encoding,
        metadata=tuple(
            (key, named_qos(text) if key == "offered_qos_profiles" else text)
            for key, text in channel.metadata.items()
        ),
    )


# --- records --------------------------------------------------------------------------------------


class _Fields(ReadDataStream):
    """Stream of the fields of a record. It raises ValueError if a field extends beyond the end of the record.

    The library's stream would return the bytes up to the end, and a damaged length would not be detected.
    """

    def __init__(self, body: Buffer) -> None:
        super().__init__(BytesIO())
        self._body = body

    def read(self, length: int) -> bytes:
        if length > len(self._body) - self._count:
            raise ValueError("a field is longer than its record")
        self._count += length
        return bytes(self._body[self._count - length : self._count])


def _sorted_out(
    records: Buffer,
) -> tuple[NDArray[np.int64], NDArray[np.void], list[tuple[int, int, int]]]:
    """Return the messages among records and the other records.

    Returns:
        (offsets of the messages in bytes, their heads, each (messages,); opcode, first and last byte of the body of
        each other record, the last byte exclusive)

    Raises one of DAMAGE.
    """
    unpack, size, place = _RECORD.unpack_from, len(records), 0
    starts, others = [], []
    while place < size:
        opcode, length = unpack(records, place)
        first = place + _RECORD.size
        if opcode == _MESSAGE:
            starts.append(place)
        else:
            others.append((opcode, first, first + length))
        place = first + length
    if place > size:
        raise ValueError("a record is longer than the data that contains it")
    offset = np.array(starts, np.int64)
    if len(offset) and offset[-1] > len(records) - _HEAD.itemsize:
        raise ValueError("a message is shorter than its head")
    cells = np.ndarray(max(len(records) - _HEAD.itemsize + 1, 0), "V31", records, strides=(1,))
    heads = cells[offset].view(_HEAD)
    if (heads["length"] < _MESSAGE_BODY).any():
        raise ValueError("a message is shorter than its head")
    return offset, heads, others


class _Chunk(NamedTuple):
    """Head of a chunk.

    Attributes:
        size: number of bytes of the decompressed records.
        checksum: CRC-32 of these bytes; 0: none.
        compression: name of the algorithm; empty: none.
        first, last: location of the compressed records in the chunk's body, the last byte exclusive.
    """

    size: int
    checksum: int
    compression: bytes
    first: int
    last: int


def _chunk(body: Buffer) -> _Chunk:
    """Return the head of a chunk; raise one of DAMAGE if it is invalid."""
    _, _, size, checksum, name_length = _CHUNK.unpack_from(body)
    first = _CHUNK.size + name_length + 8
    name = bytes(body[_CHUNK.size : first - 8])
    (length,) = struct.unpack_from("<Q", body, first - 8)
    if name not in _DECOMPRESS:
        raise ValueError(f"a chunk is compressed by {name[:8]!r}, which is neither zstd nor lz4")
    if size > LARGEST_CHUNK:
        raise ValueError(f"a chunk declares {size} bytes, more than {LARGEST_CHUNK}")
    return _Chunk(size, checksum, name, first, first + length)


def _chunk_records(body: Buffer) -> Buffer:
    """Return the decompressed records of a chunk; raise one of DAMAGE unless they are intact.

    Compressed records end by themselves, and others have the declared size. Their declared length does not count.
    """
    chunk = _chunk(body)
    records = _DECOMPRESS[chunk.compression](body[chunk.first :], chunk.size)
    if chunk.checksum and zlib.crc32(records) != chunk.checksum:
        raise ValueError("the checksum of a chunk is wrong")
    if not chunk.checksum and len(records) != chunk.size:
        raise ValueError(f"a chunk does not hold the {chunk.size} bytes that it declares")
    return records


def _is_intact_chunk(body: Buffer) -> bool:
    """Return True for the body of a chunk with a correct checksum, whose opcode is damaged if it is not that of one."""
    with suppress(*DAMAGE):
        return _chunk(body).checksum != 0 and _chunk_records(body) is not None
    return False


def _from_zstd(data: Buffer, size: int) -> bytes:
    if zstandard.frame_content_size(data) > LARGEST_CHUNK:
        raise ValueError("a chunk decompresses to too many bytes")
    return zstandard.ZstdDecompressor().decompress(data, max_output_size=size)


def _from_lz4(data: Buffer, size: int) -> bytes:
    decompressor = lz4.frame.LZ4FrameDecompressor()
    records: bytes = decompressor.decompress(bytes(data), max_length=size)
    if not decompressor.eof:
        raise ValueError("a chunk does not hold the bytes that it declares")
    return records


_DECOMPRESS: dict[bytes, Callable[[Buffer, int], Buffer]] = {
    b"": lambda data, size: data[:size],
    b"zstd": _from_zstd,
    b"lz4": _from_lz4,
}


def _extent_records(data: Buffer, extent: Extent) -> Buffer:
    """Return the records of an extent, decompressed."""
    if data[extent.first] == _MESSAGE:
        return data[extent.first : extent.last]
    return _chunk_records(data[extent.first + _RECORD.size : extent.last])


# --- survey ---------------------------------------------------------------------------------------


class _Survey:
    """Contents of a file, from its records in their order; for the attributes see `StoredFile`.

    Of several definitions with one number, the first counts. The copies of the definitions in the summary section serve
    topics without messages, and topics whose definition is damaged.
    """

    def __init__(self, data: memoryview) -> None:
        self.schemas: dict[int, Schema] = {}
        self.channels: dict[int, Channel] = {}
        self.counts: Counter[int] = Counter()
        self.extents: list[Extent] = []
        self.spans: list[tuple[int, int]] = []
        self.metadata: list[MetadataRecord] = []
        self.attachments: list[tuple[int, int]] = []
        self.remarks: list[str] = []
        self._data = data
        self._intact = len(MAGIC)  # bytes of intact records
        self._is_closed = False
        self._is_protected = False  # the chunks have checksums
        self._altered = False  # the checksum of the data section is wrong
        self._summary: list[Any] | None = None  # records after the data section
        self._read_all()
        for number in self.counts.keys() - self.channels.keys():
            lost = self.counts.pop(number)
            self.remarks.append(f"{lost} messages of channel {number} have no definition")
        self.damage = self._describe_damage()

    def _read_all(self) -> None:
        place, run = len(MAGIC), len(MAGIC)  # `run` is the first of successive messages
        while place < len(self._data) and not self._is_closed:
            end = self._end(place)
            if end is None or self._data[place] != _MESSAGE or end - run > TOGETHER_BYTES:
                self._add_messages(run, place)
                run = place
            if end is None:
                place = run = self._next_chunk(place, len(self._data))
                continue
            if self._data[place] != _MESSAGE:
                with suppress(*DAMAGE):
                    self._add(place, end)
                    self._intact += end - place
                run = end
            place = end
        self._add_messages(run, place)

    def _end(self, place: int) -> int | None:
        """Return the end of the record at a place; None if there is none, or its length is wrong.

        Another record or the end of the file follows a record of the right length, which contains no chunk. An intact
        chunk ends where its content ends.
        """
        opcode, size = self._data[place], len(self._data)
        end = self._declared_end(place)
        if end is not None and end <= size:
            is_last = end > size - _RECORD.size or self._data[end : end + len(MAGIC)] == MAGIC
            is_followed = is_last or self._declared_end(end) is not None
            if is_followed and (opcode in _CONTAINERS or self._next_chunk(place, end) == end):
                return end
        if opcode == Opcode.CHUNK:
            with suppress(*DAMAGE):
                body = self._data[place + _RECORD.size :]
                _chunk_records(body)
                return place + _RECORD.size + _chunk(body).last
        return None

    def _declared_end(self, place: int) -> int | None:
        if place + _RECORD.size > len(self._data):
            return None
        opcode, length = _RECORD.unpack_from(self._data, place)
        return place + _RECORD.size + length if opcode and length < _LONGEST else None

    def _next_chunk(self, place: int, limit: int) -> int:
        """Return the location of the next intact chunk after a place; ``limit`` if none begins before it.

        If the place is that of a chunk, the search begins after its content.
        """
        with suppress(*DAMAGE):
            if self._data[place] == Opcode.CHUNK:
                place = min(place + _chunk(self._data[place + _RECORD.size : limit]).last, limit)
        for match in _BEGINNING.finditer(self._data, place + 1, limit + _BEGINNING_BYTES):
            if match.start() >= limit:
                break
            with suppress(*DAMAGE):
                _chunk_records(self._data[match.start() + _RECORD.size :])
                return match.start()
        return limit

    def _add(self, place: int, end: int) -> None:
        """Add a record that is not a message; raise one of DAMAGE if it is damaged."""
        opcode, body = self._data[place], self._data[place + _RECORD.size : end]
        if opcode == Opcode.CHUNK or _is_intact_chunk(body):
            self._add_extent(_chunk_records(body), place, end)
            self._is_protected |= _chunk(body).checksum != 0
        elif opcode == Opcode.ATTACHMENT:
            fields = _Fields(body)
            Attachment.read(fields)
            (checksum,) = struct.unpack("<I", body[fields.count - 4 : fields.count])
            if checksum and zlib.crc32(body[: fields.count - 4]) != checksum:
                raise ValueError("the checksum of an attachment is wrong")
            self.attachments.append((place + _RECORD.size, end))
        elif opcode == Opcode.DATA_END:
            (checksum,) = struct.unpack_from("<I", body)
            self._altered = bool(checksum) and zlib.crc32(self._data[:place]) != checksum
            self._summary = []
        elif opcode == Opcode.FOOTER:
            self._close(place, end)
        elif opcode in _READERS:
            record = _READERS[opcode](_Fields(body))
            if self._summary is None:
                self._register(record)
            else:
                self._summary.append(record)

    def _add_messages(self, first: int, last: int) -> None:
        """Add successive messages outside of chunks, unless they can only be damaged indexes between the chunks."""
        if last > first and not self._is_protected:
            with suppress(*DAMAGE):
                self._add_extent(self._data[first:last], first, last)
                self._intact += last - first

    def _add_extent(self, records: Buffer, first: int, last: int) -> None:
        _, heads, others = _sorted_out(records)
        for opcode, start, end in others:
            if opcode in _READERS:
                try:
                    self._register(_READERS[opcode](_Fields(records[start:end])))
                except DAMAGE:
                    self.remarks.append("a definition of a topic is not complete, or not UTF-8")
        if len(heads):
            times = heads["log_time"]
            numbers, counts = np.unique(heads["channel"], return_counts=True)
            self.counts.update(dict(zip(numbers.tolist(), counts.tolist(), strict=True)))
            self.spans += spans_of(times)
            self.extents.append(Extent(int(times.min()), int(times.max()), first, last))

    def _register(self, record: Any) -> None:
        if isinstance(record, Metadata):
            self.metadata.append(MetadataRecord(record.name, tuple(record.metadata.items())))
        elif isinstance(record, Schema | Channel):
            known: dict[int, Any] = self.schemas if isinstance(record, Schema) else self.channels
            if known.setdefault(record.id, record) != record:
                kind = type(record).__name__.lower()
                self.remarks.append(
                    f"{kind} {record.id} is defined twice, differently; the first is used"
                )

    def _close(self, place: int, end: int) -> None:
        """Evaluate the footer: register the definitions of the summary, and compare its number of messages."""
        first, _, checksum = _FOOTER.unpack_from(self._data, place + _RECORD.size)
        summary = self._data[first or place : place + _RECORD.size + _FOOTER.size - 4]
        if self._data[end : end + len(MAGIC)] != MAGIC:
            raise ValueError("the end of the file does not follow its footer")
        self._is_closed = True
        self._intact += len(MAGIC)
        if surplus := len(self._data) - end - len(MAGIC):
            self.remarks.append(f"{surplus} bytes after its end are not read, such as another file")
            self._intact += surplus
        if checksum and zlib.crc32(summary) != checksum:
            self.remarks.append("the checksum of its summary is wrong; the summary is not used")
            return
        for record in self._summary or ():
            found, declared = self.counts.total(), getattr(record, "message_count", None)
            if declared not in (None, found):
                self.remarks.append(
                    f"its summary declares {declared} messages, its data holds {found}"
                )
            self._register(record)

    def _describe_damage(self) -> str:
        lost, size = len(self._data) - self._intact, len(self._data)
        parts = []
        if not self._is_closed:
            parts.append("it was not closed, or its end is missing")
        if lost:
            parts.append(f"{lost} of its {size} bytes ({lost / size:.2%}) cannot be read")
        elif self._altered:
            self.remarks.append(
                "the checksum of its data section is wrong: metadata records, such as the parameters and the seed of a "
                "run, may have been altered"
            )
        return "; ".join(parts)
