# SPDX-License-Identifier: Apache-2.0
"""Writes an MCAP file from columns: chunks with message indexes, and a summary (https://mcap.dev/spec).

The records of messages are put together thousands at a time; all others are written by the `mcap` library. A chunk is
compressed in a thread while the next one is put together. How messages are divided among calls leaves no trace in the
file.
"""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, BinaryIO

import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from numpy.typing import NDArray

from worm_model.bags.mcap_contents import MAGIC
from worm_model.bags.mcap_records import HEAD, INDEX_ENTRY, message_records
from worm_model.bags.payloads import Integers, Payloads, Times, groups

PROFILE = "ros2"
CHUNK_BYTES = 768 * 1024  # a chunk ends with the message that makes it larger
COMPRESSION_LEVEL = 3


class McapWriter:
    """An MCAP file in the making.

    Whoever made it closes it, finished or not.

    Args:
        stream: empty, and closed by whoever opened it.
        library: name of the program, for the header.

    Raises:
        OSError: in all methods, as the stream raises it.
    """

    def __init__(self, stream: BinaryIO, library: str) -> None:
        self._stream = stream
        self._position = 0
        self._worker = ThreadPoolExecutor(max_workers=1)
        self._compressing: tuple[_ChunkContent, Future[Chunk]] | None = None
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._chunks: list[ChunkIndex] = []
        self._attachments: list[AttachmentIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._counts: Counter[int] = Counter()
        self._span: tuple[int, int] | None = None
        self._chunk = _ChunkContent()
        self._put(MAGIC)
        self._put_record(Header(PROFILE, library))

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Append a metadata record."""
        offset = self._position
        length = self._put_record(Metadata(name=name, metadata=dict(values)))
        self._metadata.append(MetadataIndex(offset=offset, length=length, name=name))

    def add_attachment(self, name: str, media_type: str, data: bytes) -> None:
        """Append a file without a date."""
        about = {"name": name, "media_type": media_type, "log_time": 0, "create_time": 0}
        offset = self._position
        length = self._put_record(Attachment(data=data, **about))
        self._attachments.append(
            AttachmentIndex(offset=offset, length=length, data_size=len(data), **about)
        )

    def add_schema(self, name: str, encoding: str, data: bytes) -> int:
        """Make a message type known; returns its number."""
        schema = Schema(id=len(self._schemas) + 1, name=name, encoding=encoding, data=data)
        self._schemas.append(schema)
        self._chunk.add_definition(_record(schema))
        return schema.id

    def add_channel(
        self, topic: str, encoding: str, schema: int, metadata: Mapping[str, str]
    ) -> int:
        """Make a topic known; returns its number."""
        channel = Channel(
            id=len(self._channels) + 1,
            topic=topic,
            message_encoding=encoding,
            schema_id=schema,
            metadata=dict(metadata),
        )
        self._channels.append(channel)
        self._chunk.add_definition(_record(channel))
        return channel.id

    def write(self, channel: Integers, payloads: Payloads, publish_time: Times) -> None:
        """Append messages in the order that they are given in.

        Args:
            channel: of each message, shape (messages,).
            publish_time: when each was sent, ns since the epoch, shape (messages,).
        """
        if not len(payloads):
            return
        self._count(channel, payloads.log_time)
        ends = np.cumsum(payloads.size + HEAD.itemsize)
        done, written = 0, 0
        while done < len(payloads):
            room = CHUNK_BYTES - self._chunk.size
            beyond = int(np.searchsorted(ends, written + room, side="right"))
            chosen = slice(done, max(beyond, done) + 1)
            self._chunk.add(channel[chosen], payloads.select(chosen), publish_time[chosen])
            if self._chunk.size > CHUNK_BYTES:
                self.end_chunk()
            done = min(chosen.stop, len(payloads))
            written = int(ends[done - 1])

    def end_chunk(self) -> None:
        """End the chunk in the making, if there is any."""
        content, self._chunk = self._chunk, _ChunkContent()
        if content.has_messages:
            self._put_compressed()  # one at a time, in their order
            self._compressing = content, self._worker.submit(content.compressed)
        else:
            self._put(content.records())  # topics without messages: outside of chunks

    def close(self) -> None:
        """End the thread."""
        self._worker.shutdown()

    def finish(self) -> None:
        """Write what is left, and the summary."""
        self.end_chunk()
        self._put_compressed()
        self._put_record(DataEnd(0))
        start = self._position
        summary = RecordBuilder()
        offsets = [
            _write_group(summary, start, opcode, records)
            for opcode, records in self._summary_groups()
            if records
        ]
        offsets_start = start + summary.count
        for offset in offsets:
            offset.write(summary)
        data = summary.end()
        self._put(data)
        footer = Footer(summary_start=start, summary_offset_start=offsets_start, summary_crc=0)
        head = _record(footer)[: -struct.calcsize("<I")]  # the checksum covers the footer up to it
        footer.summary_crc = zlib.crc32(head, zlib.crc32(data))
        self._put_record(footer)
        self._put(MAGIC)

    def _summary_groups(self) -> list[tuple[Opcode, Sequence[Any]]]:
        return [
            (Opcode.SCHEMA, self._schemas),
            (Opcode.CHANNEL, self._channels),
            (Opcode.STATISTICS, [self.statistics()]),
            (Opcode.CHUNK_INDEX, self._chunks),
            (Opcode.ATTACHMENT_INDEX, self._attachments),
            (Opcode.METADATA_INDEX, self._metadata),
        ]

    def statistics(self) -> Statistics:
        """Numbers of what has been written; times are 0 without messages."""
        first, last = self._span or (0, 0)
        return Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(self._channels),
            channel_message_counts=dict(sorted(self._counts.items())),
            chunk_count=len(self._chunks),
            message_count=self._counts.total(),
            message_start_time=first,
            message_end_time=last,
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )

    def _count(self, channel: Integers, log_time: Times) -> None:
        counts = np.bincount(channel)
        for number in np.flatnonzero(counts).tolist():
            self._counts[number] += int(counts[number])
        first, last = int(log_time.min()), int(log_time.max())
        least, greatest = self._span or (first, last)
        self._span = min(first, least), max(last, greatest)

    def _put_compressed(self) -> None:
        """Append the chunk that is being compressed, if there is any, and its message indexes."""
        if self._compressing is None:
            return
        content, compressed = self._compressing
        self._compressing = None
        chunk = compressed.result()
        offset = self._position
        length = self._put_record(chunk)
        indexes = self._put_message_indexes(*content.index())
        self._chunks.append(
            ChunkIndex(
                chunk_start_offset=offset,
                chunk_length=length,
                compression=chunk.compression,
                compressed_size=len(chunk.data),
                uncompressed_size=chunk.uncompressed_size,
                message_start_time=chunk.message_start_time,
                message_end_time=chunk.message_end_time,
                message_index_offsets=indexes,
                message_index_length=self._position - offset - length,
            )
        )

    def _put_message_indexes(self, channel: Integers, entries: NDArray[np.void]) -> dict[int, int]:
        """Append the message index of each channel of a chunk; where each lies in the file."""
        builder = RecordBuilder()
        places: dict[int, int] = {}
        for number, rows in groups(channel):
            places[number] = self._position + builder.count
            builder.start_record(Opcode.MESSAGE_INDEX)
            builder.write2(number)
            builder.write4(len(rows) * INDEX_ENTRY.itemsize)
            builder.write(entries[rows].tobytes())
            builder.finish_record()
        self._put(builder.end())
        return places

    def _put_record(self, record: Any) -> int:
        """Append one of the library's records; returns its length."""
        data = _record(record)
        self._put(data)
        return len(data)

    def _put(self, data: bytes) -> None:
        self._stream.write(data)
        self._position += len(data)


class _ChunkContent:
    """Records that will be a chunk."""

    def __init__(self) -> None:
        self.size = 0
        self._records: list[bytes | memoryview] = []
        self._channels: list[Integers] = []
        self._entries: list[NDArray[np.void]] = []

    @property
    def has_messages(self) -> bool:
        """Whether there are more than definitions."""
        return bool(self._entries)

    def add_definition(self, record: bytes) -> None:
        """Append the record of a schema or a channel."""
        self._records.append(record)
        self.size += len(record)

    def add(self, channel: Integers, payloads: Payloads, publish_time: Times) -> None:
        """Append messages; arguments as those of McapWriter.write."""
        records, start = message_records(channel, payloads, publish_time)
        entries = np.empty(len(start), INDEX_ENTRY)
        entries["log_time"] = payloads.log_time
        entries["offset"] = start + self.size
        self._records.append(records.data)
        self._channels.append(channel)
        self._entries.append(entries)
        self.size += len(records)

    def compressed(self) -> Chunk:
        """The chunk; there must be messages in it."""
        records = self.records()
        _, entries = self.index()
        return Chunk(
            compression="zstd",
            data=zstandard.compress(records, COMPRESSION_LEVEL),
            message_start_time=int(entries["log_time"].min()),
            message_end_time=int(entries["log_time"].max()),
            uncompressed_crc=zlib.crc32(records),
            uncompressed_size=len(records),
        )

    def records(self) -> bytes:
        """All records, one behind the other."""
        return b"".join(self._records)

    def index(self) -> tuple[Integers, NDArray[np.void]]:
        """Channel, and log time and place (INDEX_ENTRY), of each message."""
        return np.concatenate(self._channels), np.concatenate(self._entries)


def _write_group(
    builder: RecordBuilder, start: int, opcode: Opcode, records: Sequence[Any]
) -> SummaryOffset:
    """Append records of a kind to a summary that starts at some byte of the file; where they lie."""
    first = builder.count
    for record in records:
        record.write(builder)
    return SummaryOffset(
        group_opcode=opcode, group_start=start + first, group_length=builder.count - first
    )


def _record(record: Any) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()
