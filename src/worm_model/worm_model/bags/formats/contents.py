# SPDX-License-Identifier: Apache-2.0
"""Contents of a file of a bag, without its messages."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import NamedTuple

from mcap.records import Channel, Metadata, Schema


@dataclass(frozen=True)
class AttachedFile:
    """File stored inside a bag."""

    name: str
    media_type: str
    data: bytes


class Extent(NamedTuple):
    """Part of a file with messages: a chunk, consecutive records outside of chunks, or rows of a database.

    Attributes:
        start, end: smallest and largest log time, ns.
        first, last: location, in bytes of the file or rows of the database's table; ``last`` is exclusive.
        is_chunk: True for a chunk.
        runs: ranges of a damaged chunk's decompressed bytes that contain complete records; empty for any other
            extent.
    """

    start: int
    end: int
    first: int
    last: int
    is_chunk: bool = False
    runs: tuple[tuple[int, int], ...] = ()


class Loss(NamedTuple):
    """Damaged part of a file.

    Attributes:
        first, last: location of the part, in the units of `Extent`.
        counts: number of missing messages by channel, according to the indexes that follow a chunk; empty: unknown.
    """

    first: int
    last: int
    counts: Counter[int]


@dataclass
class Contents:
    """Contents of a file, without its messages.

    Attributes:
        unit: unit of locations in the file: bytes, or rows.
        schemas, channels: definitions by their numbers.
        counts: number of messages by channel.
        extents: locations of the messages, in the order of the file.
        metadata: metadata records, in the order of the file.
        attachments: location of the body of each attachment: first and last byte, the last one exclusive.
        losses: damaged parts, in the order of the file.
        end: end of the last complete record of the data section, bytes.
        complete: True if the data section is complete up to its end record, or a database has all its pages.
        whole: True if the file ends like a closed file.
        complaints: one line per inconsistency of the file.
        expected: number of messages by channel according to an intact summary; None without an intact summary.
    """

    unit: str = "bytes"
    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    counts: Counter[int] = field(default_factory=Counter)
    extents: list[Extent] = field(default_factory=list)
    metadata: list[Metadata] = field(default_factory=list)
    attachments: list[tuple[int, int]] = field(default_factory=list)
    losses: list[Loss] = field(default_factory=list)
    end: int = 0
    complete: bool = False
    whole: bool = False
    complaints: list[str] = field(default_factory=list)
    expected: dict[int, int] | None = None

    def mark_lost(self, first: int, last: int) -> Loss:
        """Add a damaged part and return it."""
        self.losses.append(Loss(first, last, Counter()))
        return self.losses[-1]

    def span_around(self, loss: Loss) -> tuple[int, int]:
        """Return the latest log time before a damaged part and the earliest one after it, ns; 0 without a message."""
        before = (extent.end for extent in self.extents if extent.last <= loss.first)
        after = (extent.start for extent in self.extents if extent.first >= loss.last)
        return max(before, default=0), min(after, default=0)

    def missing(self) -> Counter[int]:
        """Return the known number of missing messages by channel, from the summary or else from the chunks' indexes."""
        if self.expected is not None:
            return Counter(self.expected) - self.counts
        total: Counter[int] = Counter()
        for loss in self.losses:
            total += loss.counts
        return total

    @property
    def sound(self) -> bool:
        """True if nothing of the file is known to be missing."""
        return self.whole and not self.losses

    def register(self, record: object) -> None:
        """Add a schema, a channel or a metadata record; of several definitions with one number, the first is used."""
        if isinstance(record, Metadata):
            self.metadata.append(record)
        elif isinstance(record, Schema):
            if self.schemas.setdefault(record.id, record) != record:
                self.complain(
                    f"schema {record.id} is defined twice, differently; the first is used"
                )
        elif isinstance(record, Channel) and self.channels.setdefault(record.id, record) != record:
            self.complain(f"channel {record.id} is defined twice, differently; the first is used")

    def complain(self, complaint: str) -> None:
        """Add a complaint unless it exists already."""
        if complaint not in self.complaints:
            self.complaints.append(complaint)
