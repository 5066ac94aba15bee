# SPDX-License-Identifier: Apache-2.0
"""Contents of an MCAP file, collected from its records. Where data section and summary differ, the data is used."""

from __future__ import annotations

import struct
import zlib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence

from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, Schema, Statistics

from worm_model.bags.formats import mcap_walk
from worm_model.bags.formats.contents import Contents, Extent, Loss
from worm_model.bags.formats.mcap_records import (
    DAMAGE,
    MAGIC,
    RECORD,
    Buffer,
    checksum_of,
    chunk_head,
    chunk_records,
    message_heads,
    read_record,
    records_in,
    release,
)

RUN_BYTES = 1 << 20  # size of the extents into which messages outside of chunks are divided
# opcode, length, start of the summary, start of the summary's offsets, checksum
_FOOTER = struct.Struct("<BQQQI")


def extent_records(data: Buffer, extent: Extent) -> Buffer:
    """Return the records of an extent, decompressed; raise one of DAMAGE if they are damaged."""
    if not extent.is_chunk:
        return data[extent.first : extent.last]
    body = data[extent.first + RECORD.size : extent.last]
    if not extent.runs:
        return chunk_records(body)
    records = mcap_walk.first_records(body)
    return b"".join(piece for run in extent.runs for piece in _run_pieces(records, *run))


def _run_pieces(records: Buffer, first: int, last: int) -> Iterator[Buffer]:
    """Yield the records of a range of `Extent.runs` in pieces.

    If the range is a single record (a definition, or a record that declares a larger length than it has), its stored
    length may be damaged. It is replaced by the length that follows from the range.
    """
    begin = first + RECORD.size
    opcode, length = RECORD.unpack_from(records, first)
    if opcode in mcap_walk.DEFINITIONS or begin + length > last:
        yield RECORD.pack(opcode, last - begin)
    else:
        yield records[first:begin]
    yield records[begin:last]


# --- the file -------------------------------------------------------------------------------------


def scan(data: Buffer) -> Contents:
    """Return the contents of a file that begins with MAGIC.

    Only the heads of the chunks are decoded if the file is closed, its summary has a correct checksum, its data section
    has a correct checksum or none, and the summary describes the data section. Otherwise every chunk is decoded.
    """
    summary, _ = _read_summary(data)
    if summary is not None and summary.is_protected:
        contents = _Survey(data, summary, mcap_walk.has_chunk_head, _Survey.add_by_head).run()
        if contents.sound and not contents.complaints and summary.describes(contents):
            for record in summary.definitions:
                contents.register(record)
            contents.counts = Counter(summary.counts)
            return contents
    return salvage(data)


def salvage(data: Buffer) -> Contents:
    """Return the readable contents of a file that begins with MAGIC; the content of every chunk is read.

    The summary supplies only the definitions that the chunks lack, and the expected number of messages.
    """
    summary, complaint = _read_summary(data)
    survey = _Survey(data, summary, mcap_walk.is_intact_chunk, _Survey.add_by_content)
    contents = survey.run()
    if survey.unprotected and any(loss.last < contents.end for loss in contents.losses):
        contents.complain(
            f"{survey.unprotected} of its messages have no checksum; some of them may have been altered"
        )
    if contents.whole:
        contents.complaints += [complaint] if complaint else []
        contents.complaints += _appended(data, contents.end)
    if summary is not None:
        contents.complaints += _contradictions(contents, summary)
        contents.expected = summary.counts
        if contents.sound and contents.missing():
            declared = sum(summary.counts.values())
            contents.complain(
                f"its summary declares {declared} messages, its data holds {contents.counts.total()}"
            )
        for record in summary.definitions:
            if isinstance(record, Schema):
                contents.schemas.setdefault(record.id, record)
                continue
            known = contents.channels.setdefault(record.id, record)
            if known is record and contents.counts[record.id]:
                contents.complaints.append(
                    f"the definition of {record.topic} is damaged in its data; the copy in its summary is used"
                )
    for number in contents.counts.keys() - contents.channels.keys():
        contents.complaints.append(
            f"{contents.counts.pop(number)} messages of channel {number} are excluded: the channel's definition is lost"
        )
    return contents


def _appended(data: Buffer, end: int) -> Iterator[str]:
    """Yield a complaint about bytes after the first footer and the MAGIC that follows it.

    ``end`` is the end of the data section.
    """
    try:
        for opcode, _, last in records_in(data[end : len(data) - len(MAGIC)]):
            if opcode == Opcode.FOOTER and (size := len(data) - end - last - len(MAGIC)):
                yield (
                    f"{size} bytes after its end are not read, such as another bag's file; store them in a separate "
                    "file to read them"
                )
                return
    except DAMAGE:
        return  # `_read_summary` reports a damaged summary


class _Summary:
    """Summary section, which follows the data: copies of schemas and channels, counts, and locations of the chunks."""

    def __init__(
        self, records: Sequence[object], statistics: Statistics, first: int, checksum: int
    ) -> None:
        self.first = first
        self.is_protected = checksum != 0
        self.counts = dict(statistics.channel_message_counts)
        self.definitions = [r for r in records if isinstance(r, Schema | Channel)]
        self._channel_count = statistics.channel_count
        self.chunk_count = statistics.chunk_count
        self.chunks = {
            (r.chunk_start_offset, r.chunk_length, r.message_start_time, r.message_end_time)
            for r in records
            if isinstance(r, ChunkIndex)
        }

    @property
    def channels(self) -> set[int]:
        """Numbers of all channels."""
        return {record.id for record in self.definitions if isinstance(record, Channel)}

    def describes(self, contents: Contents) -> bool:
        """Return True if the summary alone is sufficient for reading and is consistent with the data section."""
        schemas = {record.id for record in self.definitions if isinstance(record, Schema)}
        channels = [record for record in self.definitions if isinstance(record, Channel)]
        extents = {(e.first, e.last - e.first, e.start, e.end) for e in contents.extents}
        return (
            len(channels) == self._channel_count
            and all(not c.schema_id or c.schema_id in schemas for c in channels)
            and set(self.counts) <= self.channels
            and (extents == self.chunks or not (self.chunks or self.chunk_count))
            and not any(_contradictions(contents, self))
        )


def _read_summary(data: Buffer) -> tuple[_Summary | None, str]:
    """Return (the summary, or None if it is missing or damaged; a complaint, empty unless the summary is damaged)."""
    tail = bytes(data[-_FOOTER.size - len(MAGIC) :])
    if len(tail) < _FOOTER.size + len(MAGIC) or tail[_FOOTER.size :] != MAGIC:
        return None, ""
    opcode, _, start, _, checksum = _FOOTER.unpack_from(tail)
    if opcode != Opcode.FOOTER:
        return None, "its footer is damaged; its content was read from its data"
    end = len(data) - len(tail)
    summary = data[start:end] if start else data[:0]
    if checksum and zlib.crc32(tail[: _FOOTER.size - 4], zlib.crc32(summary)) != checksum:
        return None, "the checksum of its summary is wrong; its content was read from its data"
    try:
        records = [read_record(o, summary[a:b]) for o, a, b in records_in(summary)]
    except DAMAGE:
        return None, "its summary is damaged; its content was read from its data"
    statistics = next((record for record in records if isinstance(record, Statistics)), None)
    if statistics is None:
        return None, ""
    return _Summary(records, statistics, start, checksum), ""


def _contradictions(contents: Contents, summary: _Summary) -> Iterator[str]:
    """Yield complaints about differences between the summary of a closed file and its data section."""
    chunks = [extent for extent in contents.extents if extent.is_chunk]
    places = {place for place, *_ in summary.chunks}
    if contents.sound and summary.chunk_count and len(chunks) != summary.chunk_count:
        yield f"its summary declares {summary.chunk_count} chunks, its data holds {len(chunks)}"
    elif contents.sound and places and {extent.first for extent in chunks} != places:
        yield "the index in its summary does not lead to its chunks"
    for record in summary.definitions:
        known = contents.schemas if isinstance(record, Schema) else contents.channels
        if known.get(record.id, record) != record:
            yield "its summary and its data have different topics or types; those in its data are used"
            return


AddChunk = Callable[["_Survey", mcap_walk.Part], None]


class _Survey:
    """Collector of the contents of a file from its records.

    Args:
        data: the file.
        summary: the intact summary, or None.
        judge: returns True if the body of a chunk is accepted, see `mcap_walk.Walk`.
        add_chunk: adds a chunk to the contents, `add_by_head` or `add_by_content`.

    Attributes:
        contents: the contents.
        unprotected: number of messages that were read and that no checksum covers.
    """

    def __init__(
        self, data: Buffer, summary: _Summary | None, judge: mcap_walk.Judge, add_chunk: AddChunk
    ) -> None:
        self.contents = Contents()
        self.unprotected = 0
        self._data = data
        self._channels = summary.channels if summary else set()
        records = data[: summary.first] if summary else data
        self._walk = mcap_walk.Walk(records, len(MAGIC), self._channels, judge)
        self._add_chunk = add_chunk
        self._run: tuple[int, int] | None = None  # location of messages outside of chunks
        self._lost: Loss | None = None  # last damaged chunk, whose indexes may follow

    def run(self) -> Contents:
        """Process the records up to the end of the data section, or of the file, and return the contents."""
        contents = self.contents
        for part in self._walk:
            if part.opcode == Opcode.MESSAGE:
                self._add_message(part)
                continue
            self._close_run()
            self._add(part)
            if part.opcode != mcap_walk.DAMAGED:
                contents.end = part.last
        self._close_run()
        return contents

    def _add_message(self, part: mcap_walk.Part) -> None:
        self.contents.end = part.last
        if self._run and part.last - self._run[0] > RUN_BYTES:
            self._close_run()
        self._run = (self._run[0] if self._run else part.first), part.last

    def _close_run(self) -> None:
        if self._run:
            self._add_extent(Extent(0, 0, *self._run, is_chunk=False))
            self._run = None

    def _add(self, part: mcap_walk.Part) -> None:
        opcode, body = part.opcode, self._data[part.first + RECORD.size : part.last]
        if opcode == Opcode.MESSAGE_INDEX:
            if self._lost is not None:
                channel, count = mcap_walk.message_index(body)
                self._lost.counts[channel] += count
            return
        self._lost = None
        if opcode == mcap_walk.DAMAGED:
            self._lose(part)
        elif opcode == Opcode.CHUNK:
            self._add_chunk(self, part)
        elif opcode == Opcode.ATTACHMENT:
            self.contents.attachments.append((part.first + RECORD.size, part.last))
        elif opcode in mcap_walk.DEFINITIONS | {Opcode.METADATA}:
            self.contents.register(read_record(opcode, body))
        elif opcode == Opcode.DATA_END:
            self._end(part.first, int.from_bytes(body, "little"))

    def _end(self, place: int, checksum: int) -> None:
        contents = self.contents
        contents.complete = True
        contents.whole = self._data[-len(MAGIC) :] == MAGIC
        if checksum and checksum_of(self._data[:place]) != checksum:
            contents.complain(
                "the checksum of its data section is wrong: metadata records, such as the parameters and the seed of a "
                "run, may have been altered"
            )

    def _lose(self, part: mcap_walk.Part, found: Iterable[int] = ()) -> None:
        loss = self.contents.mark_lost(part.first, part.last)
        if self._data[part.first] == Opcode.CHUNK:
            loss.counts.subtract(found)
            self._lost = loss

    def add_by_head(self, part: mcap_walk.Part) -> None:
        """Add a chunk with the log times that its head declares."""
        head = chunk_head(self._data[part.first + RECORD.size : part.last])
        extent = Extent(head.start, head.end, part.first, part.last, True, part.runs)
        self.contents.extents.append(extent)
        release(self._data)
        if part.runs:
            self._lose(part)

    def add_by_content(self, part: mcap_walk.Part) -> None:
        """Add a chunk with the log times and the number of its messages."""
        found = self._add_extent(Extent(0, 0, part.first, part.last, True, part.runs))
        if part.runs:
            self._lose(part, found)

    def _add_extent(self, extent: Extent) -> list[int]:
        """Add an extent with the log times of its messages; return the channel number of each message."""
        contents, records = self.contents, extent_records(self._data, extent)
        self._define(records)
        release(self._data)
        _, heads = message_heads(records)
        channels: list[int] = heads["channel"].tolist()
        contents.counts.update(channels)
        if not (extent.is_chunk and chunk_head(self._data[extent.first + RECORD.size :]).checksum):
            self.unprotected += len(channels)
        if channels:  # the times in a chunk's head have no checksum and are not used
            start, end = int(heads["log_time"].min()), int(heads["log_time"].max())
            contents.extents.append(extent._replace(start=start, end=end))
        return channels

    def _define(self, records: Buffer) -> None:
        """Register the definitions among records."""
        for opcode, first, last in records_in(records):
            if opcode in mcap_walk.DEFINITIONS:
                try:
                    self.contents.register(read_record(opcode, records[first:last]))
                except DAMAGE:
                    self.contents.complain("a definition of a topic is not UTF-8, or not complete")
        self._channels.update(self.contents.channels)
