# SPDX-License-Identifier: Apache-2.0
"""Records of the MCAP format: their sequence, their content, and the content of chunks.

The format: https://mcap.dev/spec.
"""

from __future__ import annotations

import mmap
import struct
import zlib
from collections.abc import Callable, Iterable, Iterator
from io import BytesIO
from typing import NamedTuple

import lz4.frame
import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile, McapError
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

Buffer = memoryview | bytes
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
)  # head of a message record
MESSAGE_BODY = HEAD.itemsize - RECORD.size  # bytes before the payload
LARGEST_CHUNK = 256 << 20  # decompressed bytes; writers make chunks of about a megabyte
_PIECE = 4 << 20  # bytes that are processed at a time
# first and last log time, size, checksum, length of the name of the compression algorithm
_CHUNK = struct.Struct("<QQQII")
_ZSTD = zstandard.ZstdDecompressor()

DAMAGE = (
    McapError,
    struct.error,
    zstandard.ZstdError,
    RuntimeError,  # raised by lz4
    ValueError,
    KeyError,
    IndexError,
    OverflowError,
    MemoryError,  # for a damaged length
)
"""Exceptions that the functions of this module raise for damaged content."""


def release(data: Buffer) -> None:
    """Release the memory of a mapped file; a later read gets the bytes from the system's cache."""
    if isinstance(data, memoryview) and isinstance(data.obj, mmap.mmap):
        data.obj.madvise(mmap.MADV_DONTNEED)


def checksum_of(data: Buffer) -> int:
    """Return the CRC-32 of data, with only one piece in memory at a time."""
    checksum = 0
    for first in range(0, len(data), _PIECE):
        checksum = zlib.crc32(data[first : first + _PIECE], checksum)
        release(data)
    return checksum


def records_in(data: Buffer, position: int = 0) -> Iterator[tuple[int, int, int]]:
    """Yield (opcode, start, end) of each record from a position on; its body extends from start to end (exclusive).

    Raises:
        ValueError, struct.error: A record is longer than the data.
    """
    unpack, size = RECORD.unpack_from, len(data)
    while position < size:
        opcode, length = unpack(data, position)
        start = position + RECORD.size
        position = start + length
        if position > size:
            raise ValueError("a record is longer than the data that contains it")
        yield opcode, start, position


class _Fields(ReadDataStream):
    """Stream of the fields of a record. It raises EndOfFile if a field extends beyond the end of the record.

    The library's stream would return the bytes up to the end, and a damaged length would not be detected.
    """

    def __init__(self, body: Buffer) -> None:
        super().__init__(BytesIO())
        self._body = body

    def read(self, length: int) -> bytes:
        if length > len(self._body) - self._count:
            raise EndOfFile
        self._count += length
        return bytes(self._body[self._count - length : self._count])


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


def read_record(opcode: int, body: Buffer) -> object | None:
    """Return the `mcap` library's object of a record; None for kinds without a reader, such as messages and chunks.

    Raises:
        one of DAMAGE: The record is damaged, or the checksum of an attachment is wrong.
    """
    reader = _READERS.get(opcode)
    if opcode == Opcode.ATTACHMENT:
        (checksum,) = struct.unpack("<I", body[-4:])
        if checksum and zlib.crc32(body[:-4]) != checksum:
            raise ValueError("the checksum of an attachment is wrong")
    return None if reader is None else reader(_Fields(body))


def fields_size(opcode: int, body: Buffer) -> int:
    """Return the size (bytes) of the fields of a record; the declared length is ignored. Raises one of DAMAGE."""
    fields = _Fields(body)
    _READERS[opcode](fields)
    return fields.count


def message_heads(records: Buffer) -> tuple[NDArray[np.int64], NDArray[np.void]]:
    """Return (offsets in bytes, heads) of the messages among records, each (messages,). Raises one of DAMAGE."""
    wanted = Opcode.MESSAGE.value
    starts = [start for opcode, start, _ in records_in(records) if opcode == wanted]
    offset = np.array(starts, np.int64) - RECORD.size
    if len(offset) and offset[-1] > len(records) - HEAD.itemsize:
        raise ValueError("a message is shorter than its head")
    cells = np.ndarray(max(len(records) - HEAD.itemsize + 1, 0), "V31", records, strides=(1,))
    heads = cells[offset].view(HEAD)
    if (heads["length"] < MESSAGE_BODY).any():
        raise ValueError("a message is shorter than its head")
    return offset, heads


class ChunkHead(NamedTuple):
    """Fields of a chunk before its records.

    Attributes:
        start, end: smallest and largest log time, ns; no checksum covers them.
        size: number of bytes of the decompressed records.
        checksum: CRC-32 of these bytes; 0: none.
        compression: name of the algorithm; empty: none.
        first, last: location of the compressed records in the chunk's body, the last byte exclusive.
    """

    start: int
    end: int
    size: int
    checksum: int
    compression: bytes
    first: int
    last: int


def chunk_head(body: Buffer) -> ChunkHead:
    """Return the head of a chunk; raise one of DAMAGE if it is invalid."""
    start, end, size, checksum, name_length = _CHUNK.unpack_from(body)
    first = _CHUNK.size + name_length + 8
    name = bytes(body[_CHUNK.size : first - 8])
    (length,) = struct.unpack_from("<Q", body, first - 8)
    if name not in (b"", b"zstd", b"lz4"):
        raise ValueError(f"a chunk is compressed by {name[:8]!r}, which is neither zstd nor lz4")
    return ChunkHead(start, end, size, checksum, name, first, first + length)


def chunk_records(body: Buffer) -> Buffer:
    """Return the decompressed records of a chunk; raise one of DAMAGE unless they are intact.

    With a correct checksum, records are intact even if the length or size that the chunk declares is wrong.
    """
    head = chunk_head(body)
    data = joined(chunk_pieces(head, body))
    if head.checksum:
        if zlib.crc32(data) != head.checksum:
            raise ValueError("the checksum of a chunk is wrong")
    elif head.last != len(body) or len(data) != head.size:
        raise ValueError(f"a chunk does not hold the {head.size} bytes that it declares")
    return data


def joined(pieces: Iterable[Buffer]) -> Buffer:
    """Return the pieces as one buffer; a single piece is not copied."""
    parts = [piece for piece in pieces if len(piece)]
    return parts[0] if len(parts) == 1 else b"".join(parts)


def chunk_pieces(head: ChunkHead, body: Buffer) -> Iterator[Buffer]:
    """Yield the decompressed records of a chunk in pieces.

    Decompression ends after LARGEST_CHUNK bytes, as a protection against decompression bombs. It does not end at the
    size that the chunk declares, because this size may be damaged.

    Raises:
        one of DAMAGE: The compressed bytes are damaged. The earlier pieces contain the data up to the damage.
    """
    data, size = body[head.first : head.last], 0
    if not head.compression:
        yield data
        return
    read = _READ[head.compression](data)
    while size <= LARGEST_CHUNK:
        declared = head.size - size
        try:
            # Invalid data may follow the declared bytes. A read beyond the declared bytes would then fail, and the
            # declared bytes of this read would be lost.
            piece = read(min(declared, _PIECE) if declared > 0 else _PIECE)
        except DAMAGE:
            if size < head.size:
                raise
            return  # all declared bytes have been read
        if not piece:
            return
        size += len(piece)
        yield piece


def _lz4_reader(data: Buffer) -> Callable[[int], bytes]:
    decompressor, waiting = lz4.frame.LZ4FrameDecompressor(), [bytes(data)]

    def read(size: int) -> bytes:
        if decompressor.eof:
            return b""
        piece: bytes = decompressor.decompress(waiting.pop() if waiting else b"", max_length=size)
        return piece

    return read


def _zstd_reader(data: Buffer) -> Callable[[int], bytes]:
    return _ZSTD.stream_reader(data, read_across_frames=True).read


_READ: dict[bytes, Callable[[Buffer], Callable[[int], bytes]]] = {
    b"zstd": _zstd_reader,
    b"lz4": _lz4_reader,
}
