# SPDX-License-Identifier: Apache-2.0
"""The records of an MCAP file that there are many of: messages, chunks and their indexes, taken apart fast.

Rare records (schemas, channels, metadata, attachments) are left to the `mcap` library, which makes objects of them.
Those of which a replay reads thousands a second are unpacked here, according to https://mcap.dev/spec.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterator, Mapping
from io import BytesIO
from typing import NamedTuple

import lz4.frame
import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Header, Metadata, Schema, Statistics

from worm_model.bags.payloads import Bytes, Integers, Payloads, Times, cells, place

MAX_CHUNK_BYTES = 1 << 31  # more than any writer makes: a damaged length, not a chunk
RECORD = struct.Struct("<BQ")  # opcode, length
_MESSAGE = struct.Struct("<BQHIQQ")  # opcode, length, channel, sequence, log time, publish time
_MESSAGE_BODY = _MESSAGE.size - RECORD.size  # before the payload
HEAD = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log_time", "<u8"),
        ("publish_time", "<u8"),
    ]
)  # of a message, the same as columns
_CHUNK = struct.Struct("<QQQII")  # first and last log time, size, checksum, length of compression
_CHUNK_INDEX = struct.Struct("<QQQQI")  # first and last log time, offset, length, bytes of indexes
_CHANNEL_INDEX = struct.Struct("<HQ")  # channel, offset of its message index
_INDEX = struct.Struct("<BQHI")  # opcode, length, channel, bytes of entries
INDEX_ENTRY = np.dtype([("log_time", "<u8"), ("offset", "<u8")])
_ZSTD = zstandard.ZstdDecompressor()

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


class RawMessage(NamedTuple):
    """A message as it lies in the file; times in ns."""

    log_time: int
    channel: int
    data: bytes
    publish_time: int


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


_READERS: dict[int, Callable[[ReadDataStream], object]] = {
    Opcode.HEADER: Header.read,
    Opcode.SCHEMA: Schema.read,
    Opcode.CHANNEL: Channel.read,
    Opcode.METADATA: Metadata.read,
    Opcode.ATTACHMENT: Attachment.read,
    Opcode.STATISTICS: Statistics.read,
}


def read_rare(opcode: int, body: bytes) -> object | None:
    """The object of a rare record; None for any other."""
    reader = _READERS.get(opcode)
    return None if reader is None else reader(ReadDataStream(BytesIO(body)))


def walk_records(data: bytes) -> Iterator[tuple[int, int, int]]:
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


def walk_messages(data: bytes, wanted: frozenset[int] | None) -> Iterator[RawMessage]:
    """Messages of some channels (None: of all) among records, in their order.

    Raises:
        ValueError, struct.error: the records are damaged.
    """
    unpack = _MESSAGE.unpack_from
    for opcode, start, end in walk_records(data):
        if opcode != Opcode.MESSAGE:
            continue
        _, length, channel, _, log_time, publish_time = unpack(data, start - RECORD.size)
        if length < _MESSAGE_BODY:
            raise ValueError("a message is shorter than its head")
        if wanted is None or channel in wanted:
            payload = data[start + _MESSAGE_BODY : end]
            yield RawMessage(log_time, channel, payload, publish_time)


def unwrap_chunk(body: bytes) -> bytes:
    """Records inside a chunk; raises one of DAMAGE if they are not what was written."""
    _, _, size, checksum, name_length = _CHUNK.unpack_from(body)
    name = body[_CHUNK.size : _CHUNK.size + name_length]
    start = _CHUNK.size + name_length + 8
    (length,) = struct.unpack_from("<Q", body, start - 8)
    if size > MAX_CHUNK_BYTES or length != len(body) - start:
        raise ValueError("a chunk has a wrong size")
    data = _decompress(name, body[start:], size)
    if len(data) != size:
        raise ValueError(f"a chunk holds {len(data)} bytes instead of {size}")
    if checksum and zlib.crc32(data) != checksum:
        raise ValueError("the checksum of a chunk is wrong")
    return data


def _decompress(name: bytes, data: bytes, size: int) -> bytes:
    if name == b"zstd":
        return _ZSTD.decompress(data, max_output_size=size)
    if name == b"lz4":
        plain: bytes = lz4.frame.decompress(data)
        return plain
    if name == b"":
        return data
    raise ValueError(f"unknown compression {name!r}")


def read_chunk_index(body: bytes) -> Extent:
    """Where a chunk and its message indexes lie."""
    start, end, offset, length, size = _CHUNK_INDEX.unpack_from(body)
    entries = body[_CHUNK_INDEX.size : _CHUNK_INDEX.size + size]
    (indexes_length,) = struct.unpack_from("<Q", body, _CHUNK_INDEX.size + size)
    indexes = dict(_CHANNEL_INDEX.iter_unpack(entries))
    return Extent(start, end, offset, length, True, indexes or None, indexes_length)


def index_entries(indexes: bytes, place: int, channel: int) -> bytes:
    """Entries of a channel's message index, INDEX_ENTRY one after the other.

    Raises:
        ValueError, struct.error: there is no such index at this place.
    """
    opcode, _, owner, size = _INDEX.unpack_from(indexes, place)
    start = place + _INDEX.size
    whole = start + size <= len(indexes) and not size % INDEX_ENTRY.itemsize
    if opcode != Opcode.MESSAGE_INDEX or owner != channel or not whole:
        raise ValueError("a message index is not where it should be")
    return indexes[start : start + size]


def gather(
    records: Bytes, offset: Integers, limit: Integers, channel: Integers
) -> tuple[Payloads, Times]:
    """Messages whose records begin at some offsets, in place, and when they were sent.

    Args:
        records: of one or several chunks.
        offset: shape (messages,).
        limit: end of the chunk that each lies in, shape (messages,).
        channel: that each is of, shape (messages,).

    Raises:
        ValueError: there is something else at an offset.
    """
    if (offset < 0).any() or (offset > limit - HEAD.itemsize).any():
        raise ValueError("a message index points out of its chunk")
    heads = cells(records, HEAD.itemsize)[offset].view(HEAD)
    size = heads["length"].astype(np.int64) - _MESSAGE_BODY
    fits = (heads["opcode"] == Opcode.MESSAGE) & (heads["channel"] == channel) & (size >= 0)
    if not (fits & (size <= limit - offset - HEAD.itemsize)).all():
        raise ValueError("a message index points to something else")
    payloads = Payloads(records, offset + HEAD.itemsize, size, heads["log_time"].astype(np.uint64))
    return payloads, heads["publish_time"].astype(np.uint64)


def message_records(
    channel: Integers, payloads: Payloads, publish_time: Times
) -> tuple[Bytes, Integers]:
    """Records of messages, one behind the other, and where each begins; the opposite of `gather`.

    Args:
        channel: of each message, shape (messages,).
        publish_time: when each was sent, ns since the epoch, shape (messages,).
    """
    heads = np.zeros(len(payloads), HEAD)
    heads["opcode"] = Opcode.MESSAGE
    heads["length"] = payloads.size + _MESSAGE_BODY
    heads["channel"] = channel
    heads["log_time"] = payloads.log_time
    heads["publish_time"] = publish_time
    ends = np.cumsum(payloads.size + HEAD.itemsize)
    start = ends - payloads.size - HEAD.itemsize
    records = np.empty(int(ends[-1]) if len(ends) else 0, np.uint8)
    cells(records, HEAD.itemsize)[start] = heads.view(f"V{HEAD.itemsize}")
    place(payloads, records, start + HEAD.itemsize)
    return records, start
