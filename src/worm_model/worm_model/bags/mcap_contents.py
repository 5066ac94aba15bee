# SPDX-License-Identifier: Apache-2.0
"""What an MCAP file holds: by its summary, or by a scan that stops where the file stops."""

from __future__ import annotations

import struct
import zlib
from contextlib import suppress
from dataclasses import dataclass, field
from typing import BinaryIO

from mcap.opcode import Opcode
from mcap.records import Channel, Metadata, Schema, Statistics

from worm_model.bags.mcap_records import (
    DAMAGE,
    RECORD,
    Extent,
    read_chunk_index,
    read_rare,
    unwrap_chunk,
    walk_messages,
    walk_records,
)

MAGIC = b"\x89MCAP0\r\n"
PLAIN_EXTENT_BYTES = 1 << 20  # messages outside of chunks are taken in runs of about this size
_CHECKSUM_BYTES = 4
_FOOTER = struct.Struct("<BQQQI")  # opcode, length, start of the summary, of its offsets, checksum


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

    def keep(self, record: object) -> None:
        """Take note of a rare record."""
        if isinstance(record, Schema):
            self.schemas[record.id] = record
        elif isinstance(record, Channel):
            self.channels[record.id] = record
        elif isinstance(record, Metadata):
            self.metadata.append(record)


def read_contents(stream: BinaryIO, size: int) -> Contents:
    """Contents of a file of some size in bytes that begins with MAGIC."""
    try:
        return _by_summary(stream, size) or scan_contents(stream, size)
    except (*DAMAGE, OSError):  # OSError: an offset before the file's beginning
        return scan_contents(stream, size)


# --- by the summary -------------------------------------------------------------------------------


def _by_summary(stream: BinaryIO, size: int) -> Contents | None:
    """None if there is no summary that suffices, or it is not what was written."""
    stream.seek(-_FOOTER.size - len(MAGIC), 2)
    tail = stream.read()
    opcode, _, start, _, checksum = _FOOTER.unpack_from(tail)
    if tail[_FOOTER.size :] != MAGIC or opcode != Opcode.FOOTER or not start:
        return None
    stream.seek(start)
    summary = stream.read(size - len(tail) - start)
    covered = tail[: _FOOTER.size - _CHECKSUM_BYTES]  # the checksum is of the footer, too
    if checksum and zlib.crc32(covered, zlib.crc32(summary)) != checksum:
        return None
    contents = Contents(end=size, whole=True)
    statistics = _read_summary(stream, summary, contents)
    return contents if _suffices(contents, statistics) else None


def _read_summary(stream: BinaryIO, summary: bytes, contents: Contents) -> Statistics | None:
    statistics = None
    for opcode, first, last in walk_records(summary):
        body = summary[first:last]
        if opcode == Opcode.CHUNK_INDEX:
            contents.extents.append(read_chunk_index(body))
        elif opcode in (Opcode.ATTACHMENT_INDEX, Opcode.METADATA_INDEX):
            offset, length = struct.unpack_from("<QQ", body)
            if opcode == Opcode.ATTACHMENT_INDEX:
                contents.attachments.append((offset, length))
            else:
                contents.keep(_read_record(stream, offset, length))
        else:
            record = read_rare(opcode, body)
            contents.keep(record)
            statistics = record if isinstance(record, Statistics) else statistics
    return statistics


def _read_record(stream: BinaryIO, offset: int, length: int) -> object:
    stream.seek(offset)
    data = stream.read(length)
    opcode, size = RECORD.unpack_from(data)
    if size != len(data) - RECORD.size:
        raise ValueError("a record is not where its index says")
    return read_rare(opcode, data[RECORD.size :])


def _suffices(contents: Contents, statistics: Statistics | None) -> bool:
    """Whether the summary repeats all that reading needs."""
    if statistics is None:
        return False
    contents.counts = dict(statistics.channel_message_counts)
    known = all(c.schema_id in contents.schemas for c in contents.channels.values() if c.schema_id)
    indexed = len(contents.extents) == statistics.chunk_count > 0 or not statistics.message_count
    return known and indexed and len(contents.channels) == statistics.channel_count


# --- by a scan ------------------------------------------------------------------------------------


def scan_contents(stream: BinaryIO, size: int) -> Contents:
    """As `read_contents`, whatever the file's summary and indexes say."""
    scanner = _Scanner(stream, size)
    with suppress(*DAMAGE):  # `end` tells where: the rest of the file is lost
        scanner.run()
    scanner.close_run()
    return scanner.contents


class _Scanner:
    """Walks through the records of a file and takes note of what is where."""

    def __init__(self, stream: BinaryIO, size: int) -> None:
        self.contents = Contents(end=len(MAGIC))
        self._stream = stream
        self._size = size
        self._run: list[int] = []  # offset, least and greatest log time of a run of plain messages

    def run(self) -> None:
        """Walk until the end, or until a record is not whole."""
        while not self.contents.whole:
            self._stream.seek(self.contents.end)
            opcode, length = RECORD.unpack(self._stream.read(RECORD.size))
            if length > self._size - self._stream.tell():
                return  # cut off
            self._take(opcode, length)
            self.contents.end += RECORD.size + length
            if opcode == Opcode.FOOTER:
                self.contents.whole = self._stream.read() == MAGIC
                return

    def close_run(self) -> None:
        """End a run of plain messages before something else."""
        if self._run:
            offset, start, end = self._run
            length = self.contents.end - offset
            self.contents.extents.append(Extent(start, end, offset, length, is_chunk=False))
            self._run = []

    def _take(self, opcode: int, length: int) -> None:
        if opcode == Opcode.ATTACHMENT:
            self.contents.attachments.append((self.contents.end, RECORD.size + length))
            self._stream.seek(length, 1)
            return
        body = self._stream.read(length)
        if opcode == Opcode.MESSAGE:
            self._message(body)
            return
        self.close_run()
        if opcode == Opcode.CHUNK:
            self._chunk(body)
        else:
            self.contents.keep(read_rare(opcode, body))

    def _message(self, body: bytes) -> None:
        channel, _, log_time, _ = struct.unpack_from("<HIQQ", body)
        self.contents.counts[channel] = self.contents.counts.get(channel, 0) + 1
        here = self.contents.end
        if not self._run:
            self._run = [here, log_time, log_time]
        self._run[1:] = min(log_time, self._run[1]), max(log_time, self._run[2])
        if here - self._run[0] > PLAIN_EXTENT_BYTES:
            offset, start, end = self._run
            length = here + RECORD.size + len(body) - offset
            self.contents.extents.append(Extent(start, end, offset, length, is_chunk=False))
            self._run = []

    def _chunk(self, body: bytes) -> None:
        try:
            data = unwrap_chunk(body)
            registered = [
                read_rare(opcode, data[first:last])
                for opcode, first, last in walk_records(data)
                if opcode in (Opcode.SCHEMA, Opcode.CHANNEL)
            ]
            messages = [(m.log_time, m.channel) for m in walk_messages(data, None)]
        except DAMAGE:
            self.contents.damaged_chunks += 1
            return
        for record in registered:
            self.contents.keep(record)
        for _, channel in messages:
            self.contents.counts[channel] = self.contents.counts.get(channel, 0) + 1
        if messages:
            start, end = min(messages)[0], max(messages)[0]
            length = RECORD.size + len(body)
            self.contents.extents.append(
                Extent(start, end, self.contents.end, length, is_chunk=True)
            )
