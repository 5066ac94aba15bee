# SPDX-License-Identifier: Apache-2.0
"""Iteration over the records of an MCAP file, which continues after damage at the next plausible record.

A record is plausible if all of these hold:

- Its kind is allowed at its place, and its length fits into the data.
- Its body is valid for its kind. A chunk has a correct checksum or, without a checksum, the declared size, and consists
  of complete records. The checksum of an attachment is correct. A message belongs to a defined channel. An index of
  messages consists of complete entries. In records of other kinds, texts and maps are UTF-8 and fit into the record.
- The next record satisfies the two conditions above, or there is no next record. This condition does not apply to a
  chunk that contains records. After a DATA_END record, only the kind of the next record is checked.

After damage, stricter rules apply:

- A schema, channel or metadata record with a damaged length ends where its fields end, if a plausible record or the end
  of the data follows there.
- Messages, schemas and channels outside of chunks are searched for only in a file that has no chunks, or whose chunks
  have no checksums. In other files, such a record could only be content of a damaged chunk, and no checksum could
  verify the record.
- Headers, records with a private opcode and records longer than a terabyte are not searched for.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from functools import cached_property
from typing import NamedTuple

from mcap.opcode import Opcode

from worm_model.bags.formats.mcap_records import (
    DAMAGE,
    MESSAGE_BODY,
    RECORD,
    Buffer,
    ChunkHead,
    chunk_head,
    chunk_pieces,
    chunk_records,
    fields_size,
    joined,
    read_record,
    records_in,
)

DAMAGED = 0  # used as an opcode: bytes that are not part of a complete record
FIRST_PRIVATE_OPCODE = 0x80
_NUMBER = struct.Struct("<H")  # number of a channel
_INDEX = struct.Struct("<HI")  # number of a channel, size of the entries in bytes
_ENTRY_BYTES = 16
DEFINITIONS = frozenset({Opcode.SCHEMA, Opcode.CHANNEL})
_INSIDE = DEFINITIONS | {Opcode.MESSAGE}  # allowed inside a chunk
_MESSAGE = Opcode.MESSAGE.value
# kinds outside of chunks that are searched for after damage if the chunks have checksums
_PROTECTED = frozenset(
    {Opcode.CHUNK, Opcode.MESSAGE_INDEX, Opcode.ATTACHMENT, Opcode.METADATA, Opcode.DATA_END}
)
_DATA = _INSIDE | _PROTECTED | {Opcode.HEADER}
# kinds of parts whose end is not checked against the next part
_PROVEN = frozenset({DAMAGED, Opcode.CHUNK, Opcode.ATTACHMENT, Opcode.DATA_END})
_SUMMARY = range(Opcode.FOOTER, Opcode.DATA_END)

Judge = Callable[[Buffer], bool]


class Part(NamedTuple):
    """Record, or damaged bytes between two records.

    Attributes:
        opcode: opcode of the record, or DAMAGED.
        first, last: range of bytes [first, last) in the data, including the head of the record.
        runs: ranges of a damaged chunk's decompressed bytes that contain complete records, see `_whole_runs`.
    """

    opcode: int
    first: int
    last: int
    runs: tuple[tuple[int, int], ...] = ()


def has_chunk_head(body: Buffer) -> bool:
    """Return True if the head of a chunk is valid."""
    try:
        return chunk_head(body).last == len(body)
    except DAMAGE:
        return False


def is_intact_chunk(body: Buffer) -> bool:
    """Return True if the content of a chunk is valid."""
    try:
        return all(
            _belongs(opcode, _INSIDE) and (opcode != _MESSAGE or last - first >= MESSAGE_BODY)
            for opcode, first, last in records_in(chunk_records(body))
        )
    except DAMAGE:
        return False


def _belongs(opcode: int, kinds: frozenset[int]) -> bool:
    return opcode in kinds or opcode >= FIRST_PRIVATE_OPCODE


class Walk:
    """Iterable over the parts of a file's data section, or of the records of a chunk, in their order.

    Args:
        data: the records.
        first: location of the first record.
        channels: numbers of the defined channels; the caller adds the channels that are defined inside of chunks.
        judge: returns True if the body of a chunk is accepted: `has_chunk_head`, or the stricter `is_intact_chunk`.
        kinds: allowed opcodes, either inside a chunk or in a data section.
    """

    def __init__(
        self,
        data: Buffer,
        first: int,
        channels: set[int],
        judge: Judge,
        kinds: frozenset[int] = _DATA,
    ) -> None:
        self._data = data
        self._size = len(data)
        self._first = first
        self._channels = channels
        self._judge = judge
        self._kinds = kinds

    def __iter__(self) -> Iterator[Part]:
        part = self._part(self._first)
        while part is not None:
            behind = None
            if part.opcode not in _PROVEN:
                behind = self._part(part.last)
                if behind is not None and behind.opcode == DAMAGED:
                    # A record that lost bytes, or whose length is too large, extends over later records.
                    shorter = self._before_next(part.first, part.last)
                    if shorter.last < part.last:
                        part, behind = shorter, None
            yield part
            if part.opcode == Opcode.DATA_END:
                return
            part = behind or self._part(part.last)

    def _part(self, place: int) -> Part | None:
        """Return the part that begins at a place; None at the end."""
        if place >= self._size:
            return None
        part = self._record(place, self._judge) or self._damaged_chunk(place)
        return part or self._before_next(place, self._size)

    def _record(self, place: int, judge: Judge) -> Part | None:
        """Return the complete record at a place, or None."""
        if place + RECORD.size > self._size:
            return None
        opcode, length = RECORD.unpack_from(self._data, place)
        first, last = place + RECORD.size, place + RECORD.size + length
        if last <= self._size and _belongs(opcode, self._kinds):
            body = self._data[first:last]
            # A record with a private opcode may be a chunk with a damaged opcode.
            hidden = opcode >= FIRST_PRIVATE_OPCODE and is_intact_chunk(body)
            if not hidden and self._is_whole(opcode, body, judge):
                return self._defined(Part(opcode, place, last))
        return self._chunk_by_content(place, last)

    def _is_whole(self, opcode: int, body: Buffer, judge: Judge) -> bool:
        if opcode == Opcode.MESSAGE:
            return (
                len(body) >= MESSAGE_BODY and int.from_bytes(body[:2], "little") in self._channels
            )
        if opcode == Opcode.MESSAGE_INDEX:
            return len(body) % _ENTRY_BYTES == _INDEX.size
        if opcode == Opcode.DATA_END:
            return len(body) == 4
        if opcode == Opcode.CHUNK:
            return has_chunk_head(body) and judge(body)
        try:
            read_record(opcode, body)
        except DAMAGE:
            return False
        return True

    def _chunk_by_content(self, place: int, last: int) -> Part | None:
        """Return the chunk at a place whose content is intact but whose opcode or declared length is wrong, or None."""
        head, first = self._chunk_head(place), place + RECORD.size
        if head is None or not (head.size or head.checksum):
            return None  # zeros look like an empty chunk
        ends = {first + head.last, last}
        if self._data[place] == Opcode.CHUNK and len(ends) == 1:
            return None  # `_is_whole` has rejected this chunk
        for end in sorted(ends):
            if end <= self._size and is_intact_chunk(self._data[first:end]):
                return Part(Opcode.CHUNK, place, end)
        return None

    def _damaged_chunk(self, place: int) -> Part | None:
        """Return the damaged or truncated chunk at a place with the ranges of its complete records.

        Returns None if there is no such chunk, if it has a checksum, or if it has no complete record.
        """
        head = self._chunk_head(place)
        if head is None or head.checksum or self._data[place] != Opcode.CHUNK:
            return None
        records = first_records(self._data[place + RECORD.size :])
        parts = list(Walk(records, 0, self._channels, has_chunk_head, _INSIDE))
        if (
            parts
            and len(records) == head.size
            and self._is_last_message(records[parts[-1].first :])
        ):
            parts[-1] = parts[-1]._replace(opcode=Opcode.MESSAGE)
        runs = _whole_runs(records, parts)
        if not runs:
            return None
        # The end of damaged compressed data is uncertain: further records may begin before the declared end.
        if head.compression:
            return Part(Opcode.CHUNK, place, self._next_plausible(place + 1, self._size), runs)
        last = min(place + RECORD.size + head.last, self._size)
        return Part(Opcode.CHUNK, place, last, runs)

    def _is_last_message(self, record: Buffer) -> bool:
        """Return True if the record that ends a chunk is a message, with at most one wrong bit in its length."""
        body = record[RECORD.size :]
        if record[0] != _MESSAGE or not self._is_whole(_MESSAGE, body, has_chunk_head):
            return False
        _, length = RECORD.unpack_from(record)
        return bool((length ^ len(body)).bit_count() <= 1)

    def _chunk_head(self, place: int) -> ChunkHead | None:
        if Opcode.CHUNK not in self._kinds:
            return None
        try:
            return chunk_head(self._data[place + RECORD.size :])
        except DAMAGE:
            return None

    # --- after damage -------------------------------------------------------------------------

    def _before_next(self, place: int, end: int) -> Part:
        """Return the part up to the next plausible record or ``end``: DAMAGED, or a record with a damaged length."""
        opcode = self._data[place]
        if opcode in self._kinds & (DEFINITIONS | {Opcode.METADATA}):
            with suppress(*DAMAGE):
                size = RECORD.size + fields_size(opcode, self._data[place + RECORD.size : end])
                if self._next_plausible(place + 1, place + size) == place + size:
                    return self._defined(Part(opcode, place, place + size))
        return Part(DAMAGED, place, self._next_plausible(place + 1, end))

    def _defined(self, part: Part) -> Part:
        """Return a record. If it defines a channel, add the channel's number to the defined ones."""
        if part.opcode == Opcode.CHANNEL:
            (number,) = _NUMBER.unpack_from(self._data, part.first + RECORD.size)
            self._channels.add(number)
        return part

    @cached_property
    def _beginnings(self) -> re.Pattern[bytes]:
        """Pattern of the possible beginnings of a plausible record: a kind, and a length below a terabyte."""
        kinds = self._kinds - {Opcode.HEADER}
        if Opcode.CHUNK in kinds and self._has_checksums:
            kinds = _PROTECTED
        codes = b"".join(b"\\x%02x" % kind for kind in kinds)
        return re.compile(rb"(?s)[" + codes + rb"](?=.{5}\0\0\0)")

    @property
    def _has_checksums(self) -> bool:
        """True if the chunks have checksums.

        A chunk counts only if the length of its record agrees with the length of its compressed bytes. The first intact
        chunk that counts decides. If none is intact, the first chunk that counts decides.
        """
        damaged: list[bool] = []
        for match in re.finditer(rb"(?s)\x06(?=.{5}\0\0\0)", self._data):
            head, first = self._chunk_head(match.start()), match.start() + RECORD.size
            _, length = RECORD.unpack_from(self._data, match.start())
            if head is None or head.last != length:
                continue
            if is_intact_chunk(self._data[first : first + length]):
                return bool(head.checksum)
            damaged.append(bool(head.checksum))
        return any(damaged[:1])

    def _next_plausible(self, place: int, end: int) -> int:
        """Return the location of the next plausible record from ``place`` on; ``end`` if none begins before it."""
        for match in self._beginnings.finditer(self._data, place, end + RECORD.size - 1):
            if self._is_plausible(match.start()):
                return match.start()
        return end

    def _is_plausible(self, place: int) -> bool:
        part = self._certain(place)
        if part is None:
            return False
        if part.opcode == Opcode.CHUNK:
            head = chunk_head(self._data[place + RECORD.size :])
            if head.checksum or head.size:
                return True
        if part.opcode == Opcode.DATA_END and part.last < self._size:
            return self._data[part.last] in _SUMMARY
        return part.last == self._size or self._certain(part.last) is not None

    def _certain(self, place: int) -> Part | None:
        """Return the record at a place if it is valid for its kind and its opcode is not private, else None."""
        part = self._record(place, is_intact_chunk)
        if part is None or part.opcode >= FIRST_PRIVATE_OPCODE:
            return None
        if part.opcode == Opcode.MESSAGE_INDEX:
            _, size = _INDEX.unpack_from(self._data, place + RECORD.size)
            if size != part.last - place - RECORD.size - _INDEX.size:
                return None
        return part


def first_records(body: Buffer) -> Buffer:
    """Return the decompressed records of a chunk up to the first damage of its compressed bytes."""
    pieces: list[Buffer] = []
    try:
        for piece in chunk_pieces(chunk_head(body), body):
            pieces.append(piece)
    except DAMAGE:
        pass
    return joined(pieces)


def _whole_runs(records: Buffer, parts: Iterable[Part]) -> tuple[tuple[int, int], ...]:
    """Return the ranges of consecutive complete records without damage.

    A definition forms a separate range, and so does a record that declares a larger length than it has.
    """
    runs: list[tuple[int, int]] = []
    alone = True
    for part in parts:
        if part.opcode == DAMAGED:
            continue
        _, length = RECORD.unpack_from(records, part.first)
        is_longer = part.first + RECORD.size + length > part.last
        alone, before = is_longer or part.opcode in DEFINITIONS, alone
        if runs and runs[-1][1] == part.first and not (alone or before):
            runs[-1] = runs[-1][0], part.last
        else:
            runs.append((part.first, part.last))
    return tuple(runs)


def message_index(body: Buffer) -> tuple[int, int]:
    """Return the channel of an index of messages and the number of messages that it lists."""
    channel, _ = _INDEX.unpack_from(body)
    return channel, len(body) // _ENTRY_BYTES
