# SPDX-License-Identifier: Apache-2.0
"""MCAP files (https://mcap.dev/spec), open for reading.

Opening a file surveys its records in their order. Records of kinds that the specification reserves are skipped, and so
are additional fields at the end of a record, as later versions of the format may have them. A chunk that does not
decompress, fails its checksum, or declares more than LARGEST_CHUNK bytes is skipped. Where the sequence of
records is broken, reading continues at the next intact chunk; if there is none, the file ends there, as at a cut.
"""

from __future__ import annotations

import mmap
import re
import struct
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO, cast

import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile, McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, Metadata, Schema, Statistics
from mcap.stream_reader import get_chunk_data_stream
from numpy.typing import NDArray

from worm_model.bags.formats.bag_errors import BagError
from worm_model.bags.formats.finding import check_readable
from worm_model.bags.formats.message_block import Messages, Topic
from worm_model.bags.formats.stored_file import (
    AttachedFile,
    Extent,
    MetadataRecord,
    StoredFile,
    spans_of,
)

Buffer = memoryview | bytes
MAGIC = b"\x89MCAP0\r\n"
LARGEST_CHUNK = 256 << 20  # decompressed bytes; writers make chunks of about a megabyte
TOGETHER_BYTES = 1 << 20  # size at which an extent of messages outside of chunks ends
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
_COMPRESSIONS = ("", "zstd", "lz4")
# beginning of the record of a chunk; the length of the name of its compression algorithm precedes the name
_BEGINNING = re.compile(rb"(?s)\x06(?=.{36}(?:\0{4}|\x04\0{3}zstd|\x03\0{3}lz4))")
_MESSAGE, _CHUNK_RECORD = Opcode.MESSAGE.value, Opcode.CHUNK.value
_CONTAINERS = (_CHUNK_RECORD, _MESSAGE, Opcode.ATTACHMENT)  # may contain any bytes
_READERS: dict[int, Callable[[ReadDataStream], Any]] = {
    Opcode.SCHEMA: Schema.read,
    Opcode.CHANNEL: Channel.read,
    Opcode.METADATA: Metadata.read,
    Opcode.STATISTICS: Statistics.read,
}


class McapFile(StoredFile):
    """MCAP file. Opening it reads every record once.

    Of several definitions with one number, the first counts. The copies of the definitions in the summary section serve
    topics without messages, and topics whose definition is damaged.

    Raises BagError if the file is empty or not an MCAP file.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        check_readable(path)
        try:
            with path.open("rb") as stream:
                mapped = mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)
        except ValueError:
            raise BagError(f"{path} is empty: nothing was recorded, or its disk was full") from None
        self._data = memoryview(mapped)
        if self._data[: len(MAGIC)] != MAGIC:
            beginning = bytes(self._data[: len(MAGIC)])
            raise BagError(f"{path} is not an MCAP file: it begins with {beginning!r}")
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._counts: Counter[int] = Counter()  # messages by channel
        self._declared: int | None = None  # number of messages according to the summary
        self._missing = 0  # bytes that cannot be read
        self._is_chunked = False
        self._is_altered = False  # the checksum of the data section is wrong
        self._survey()
        self.channels = {
            number: _topic(channel, self._schemas.get(channel.schema_id), self._counts[number])
            for number, channel in sorted(self._channels.items())
        }
        self._topics = tuple(self.channels.values())
        for number in self._counts.keys() - self.channels.keys():
            self.remarks.append(
                f"{self._counts[number]} messages of channel {number} have no definition"
            )

    def messages(self, extent: Extent, topics: frozenset[str]) -> Messages:
        """Return the messages of some topics in an extent, in the order of the file."""
        part = self._data[extent.first : extent.last]
        records = part if part[0] == _MESSAGE else _content(part)[0]
        offset, heads, _ = _sorted_out(records)
        channel = np.full(len(heads), -1)
        for row, (number, topic) in enumerate(self.channels.items()):
            if topic.name in topics:
                channel[heads["channel"] == number] = row
        rows = np.flatnonzero(channel >= 0)
        return Messages(
            self._topics,
            np.frombuffer(records, np.uint8),
            channel[rows],
            offset[rows] + _HEAD.itemsize,
            heads["length"][rows].astype(np.int64) - _MESSAGE_BODY,
            heads["log_time"][rows].astype(np.uint64),
            heads["publish_time"][rows].astype(np.uint64),
        )

    # --- survey -----------------------------------------------------------------------------------

    def _survey(self) -> None:
        end = None
        for opcode, first, last, content in self._walk():
            if opcode == Opcode.FOOTER and self._data[last : last + len(MAGIC)] == MAGIC:
                end = last + len(MAGIC)
                break
            try:
                self._read(opcode, first, last, content)
            except DAMAGE:
                self._missing += last - first
        size, found = len(self._data), self._counts.total()
        if self._declared not in (None, found):
            self.remarks.append(
                f"its summary declares {self._declared} messages, its data holds {found}"
            )
        damage = ["it was not closed, or its end is missing"] if end is None else []
        if end is not None and end < size:
            self.remarks.append(
                f"{size - end} bytes after its end are not read, such as another file"
            )
        if self._missing:
            share = self._missing / size
            damage.append(f"{self._missing} of its {size} bytes ({share:.2%}) cannot be read")
        elif self._is_altered:
            self.remarks.append(
                "the checksum of its data section is wrong: metadata records, such as the parameters and the seed of a "
                "run, may have been altered"
            )
        self.damage = "; ".join(damage)

    def _read(self, opcode: int, first: int, last: int, content: Buffer) -> None:
        """Read a record; raise one of DAMAGE if it is damaged."""
        if opcode == _CHUNK_RECORD:
            self._is_chunked = True
            self._add_extent(content, first, last)
        elif opcode == _MESSAGE:
            if self._is_chunked:
                raise ValueError("a damaged record between chunks, not a message")
            self._add_extent(content, first, last)
        elif opcode == Opcode.ATTACHMENT:
            self._add_attachment(content)
        elif opcode == Opcode.DATA_END:
            (checksum,) = struct.unpack_from("<I", content)
            self._is_altered = checksum not in (0, zlib.crc32(self._data[:first]))
        elif opcode in _READERS:
            self._register(_READERS[opcode](_fields(content)))

    def _walk(self) -> Iterator[tuple[int, int, int, Buffer]]:
        """Yield (opcode, first byte, last byte, content) of the records in their order; the last byte is exclusive.

        Successive messages outside of chunks are one item. The content of a chunk is its decompressed records; a
        damaged chunk is left out.
        """
        data = self._data
        place = searched = len(MAGIC)
        while place < len(data):
            opcode, end = _record(data, place)
            is_too_long = opcode not in _CONTAINERS and _next_chunk(data[:end], place + 1)[0] < end
            if not opcode or is_too_long:
                chunk, end = _next_chunk(data, searched)
                # Only a head is missing if the length of this chunk, or of a record before it, is wrong.
                self._missing += max(chunk - place, 0) or _RECORD.size
                opcode, place, searched = _CHUNK_RECORD, chunk, chunk + 1
            following = _record(data, end)
            while opcode == following[0] == _MESSAGE and end - place < TOGETHER_BYTES:
                end = following[1]
                following = _record(data, end)
            first, place = place, end
            content: Buffer = data[first + (0 if opcode == _MESSAGE else _RECORD.size) : end]
            if opcode == _CHUNK_RECORD:
                try:
                    content, length = _content(data[first:end])
                except DAMAGE:
                    self._missing += end - first
                    continue
                searched = first + length
            yield opcode, first, end, content

    def _add_extent(self, records: Buffer, first: int, last: int) -> None:
        _, heads, others = _sorted_out(records)
        for opcode, start, end in others:
            if opcode in _READERS:
                try:
                    self._register(_READERS[opcode](_fields(records[start:end])))
                except DAMAGE:
                    self.remarks.append("a definition of a topic is not complete, or not UTF-8")
        if len(heads):
            times = heads["log_time"]
            numbers, counts = np.unique(heads["channel"], return_counts=True)
            self._counts.update(dict(zip(numbers.tolist(), counts.tolist(), strict=True)))
            self.spans += spans_of(times)
            self.extents.append(Extent(int(times.min()), int(times.max()), first, last))

    def _add_attachment(self, body: Buffer) -> None:
        fields = _fields(body)
        attached = Attachment.read(fields)
        (checksum,) = struct.unpack("<I", body[fields.count - 4 : fields.count])
        if checksum and zlib.crc32(body[: fields.count - 4]) != checksum:
            raise ValueError("the checksum of an attachment is wrong")
        self.attachments.append(AttachedFile(attached.name, attached.media_type, attached.data))

    def _register(self, record: Any) -> None:
        if isinstance(record, Metadata):
            self.metadata.append(MetadataRecord(record.name, tuple(record.metadata.items())))
        elif isinstance(record, Statistics):
            self._declared = record.message_count
        else:
            kind = type(record).__name__.lower()
            known: dict[int, Any] = {"schema": self._schemas, "channel": self._channels}[kind]
            if known.setdefault(record.id, record) != record:
                self.remarks.append(
                    f"{kind} {record.id} is defined twice, differently; the first is used"
                )


def _topic(channel: Channel, schema: Schema | None, count: int) -> Topic:
    return Topic(
        name=channel.topic,
        type_name=schema.name if schema else "",
        count=count,
        definition=schema.data.decode(errors="replace") if schema else "",
        definition_format=schema.encoding if schema else "",
        encoding=channel.message_encoding,
        metadata=tuple(channel.metadata.items()),
    )


# --- records --------------------------------------------------------------------------------------


def _record(data: Buffer, place: int) -> tuple[int, int]:
    """Return opcode and end of the record at a place; opcode 0 if none begins there, or it would exceed the data."""
    if place + _RECORD.size <= len(data):
        opcode, length = _RECORD.unpack_from(data, place)
        if place + _RECORD.size + length <= len(data):
            return opcode, place + _RECORD.size + length
    return 0, place


class _Bytes:
    """Stream that raises EndOfFile where it would return fewer bytes, so that a damaged length is detected."""

    def __init__(self, data: Buffer) -> None:
        self._data = memoryview(data)
        self._place = 0

    def read(self, size: int) -> bytes:
        first, self._place = self._place, self._place + size
        if self._place > len(self._data):
            raise EndOfFile
        return bytes(self._data[first : self._place])


def _fields(body: Buffer) -> ReadDataStream:
    return ReadDataStream(cast(BinaryIO, _Bytes(body)))


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


def _content(record: Buffer) -> tuple[bytes, int]:
    """Return the decompressed records of a chunk, and the length of its record without additional fields.

    Raises one of DAMAGE unless they are intact.
    """
    fields = _fields(record[_RECORD.size :])
    chunk = Chunk.read(fields)
    if chunk.compression not in _COMPRESSIONS or chunk.uncompressed_size > LARGEST_CHUNK:
        raise ValueError(
            f"a chunk of {chunk.uncompressed_size} bytes, compressed by {chunk.compression[:8]!r}, is not read"
        )
    stream, size = get_chunk_data_stream(chunk, validate_crc=True)
    if not chunk.uncompressed_crc and size != chunk.uncompressed_size:
        raise ValueError(f"a chunk does not hold the {chunk.uncompressed_size} bytes it declares")
    return stream.read(size), _RECORD.size + fields.count


def _next_chunk(data: Buffer, place: int) -> tuple[int, int]:
    """Return first and last byte of the next intact chunk with content, twice the size of the data without one."""
    for match in _BEGINNING.finditer(data, place):
        with suppress(*DAMAGE):
            records, length = _content(data[match.start() :])
            if len(records):
                return match.start(), match.start() + length
    return len(data), len(data)
