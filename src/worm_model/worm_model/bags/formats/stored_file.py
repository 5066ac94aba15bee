# SPDX-License-Identifier: Apache-2.0
"""File of a bag that is open for reading, whatever its format."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from worm_model.bags.formats.message_block import Messages, Times, Topic

# A longer time without a message is a gap: durations do not include it, and the player skips it.
LONGEST_GAP_NS = 3_600 * 10**9

Span = tuple[int, int]  # first and last log time, ns


@dataclass(frozen=True)
class AttachedFile:
    """File stored inside a bag."""

    name: str
    media_type: str
    data: bytes


@dataclass(frozen=True)
class MetadataRecord:
    """Named metadata record with one text per key. Several records of a bag may have the same name."""

    name: str
    values: tuple[tuple[str, str], ...]


class Extent(NamedTuple):
    """Part of a file with messages.

    Attributes:
        start, end: smallest and largest log time, ns.
        first, last: location of the part, the last place exclusive: bytes of an MCAP file, log times of a database.
    """

    start: int
    end: int
    first: int
    last: int


class StoredFile(ABC):
    """File with messages that is open for reading.

    Args:
        path: the file.

    Attributes:
        channels: topics by channel number.
        extents: parts of the file with messages.
        spans: first and last log time (ns) of each part without a gap, unsorted.
        metadata: metadata records, in the order of the file.
        attachments: the attached files.
        damage: one line on what is missing or damaged; empty for a file that is complete.
        remarks: one line per inconsistency of the file.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.channels: dict[int, Topic] = {}
        self.extents: list[Extent] = []
        self.spans: list[Span] = []
        self.metadata: list[MetadataRecord] = []
        self.attachments: list[AttachedFile] = []
        self.damage = ""
        self.remarks: list[str] = []

    @abstractmethod
    def messages(self, extent: Extent, topics: frozenset[str]) -> Messages:
        """Return the messages of some topics in an extent, in the order of the file."""

    def close(self) -> None:  # noqa: B027 - a file in memory needs none
        """Close the file; arrays that were read from it stay valid."""


def spans_of(times: Times) -> list[Span]:
    """Return first and last log time (ns) of each part of some messages without a gap."""
    ordered = np.sort(times)
    cuts = np.flatnonzero(np.diff(ordered) > LONGEST_GAP_NS) + 1
    return [(int(part[0]), int(part[-1])) for part in np.split(ordered, cuts) if len(part)]


def joined_spans(spans: Iterable[Span]) -> Sequence[Span]:
    """Return spans in order of time; those without a gap between them are joined."""
    joined: list[Span] = []
    for start, end in sorted(spans):
        if joined and start - joined[-1][1] <= LONGEST_GAP_NS:
            joined[-1] = joined[-1][0], max(end, joined[-1][1])
        else:
            joined.append((start, end))
    return joined
