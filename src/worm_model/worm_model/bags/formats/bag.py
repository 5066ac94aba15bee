# SPDX-License-Identifier: Apache-2.0
"""Bag in any supported format, open for reading. Its files are read lazily, in parts (`contents.Extent`)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import groupby
from operator import itemgetter
from pathlib import Path

import numpy as np
import zstandard
from zstandard import ZstdDecompressor

from worm_model.bags.formats.bag_errors import RECOVER, BagError
from worm_model.bags.formats.cdr import check_length
from worm_model.bags.formats.contents import AttachedFile, Extent
from worm_model.bags.formats.mcap_records import LARGEST_CHUNK
from worm_model.bags.formats.message_block import (
    Message,
    Messages,
    Topic,
    cells,
    merge,
    messages_of,
)
from worm_model.bags.formats.message_types import PACKAGE, with_definition
from worm_model.bags.formats.stored_file import LATEST_NS, StoredFile

DECOMPRESSED_BYTES = 16 << 20  # largest size of a block of several decompressed messages

Notify = Callable[[str], None]


@dataclass(frozen=True)
class MetadataRecord:
    """Named metadata record with one text per key. Several records of a bag may have the same name."""

    name: str
    values: tuple[tuple[str, str], ...]


class Bag:
    """Bag that is open for reading; a context manager.

    Args:
        path: directory or file from which the bag was opened.
        files: the open files; closed with the bag.
        notify: called with one line for each inconsistency of the bag.

    Attributes:
        channels: topics with their layouts; a topic whose layout changes occurs once for each layout.
        start: smallest log time, ns since the epoch; 0 in an empty bag.
        end: largest log time, ns since the epoch, without the messages later than LATEST_NS; 0 in an empty bag.
        records: metadata records in the order of the files; identical records occur once. A recording has one record
            ``worm_gait`` for each gait that was run.
        topics: topics by name. Each topic has its last layout, and its count includes the messages of all layouts.
    """

    def __init__(
        self, path: Path, files: Sequence[StoredFile], notify: Notify = lambda _: None
    ) -> None:
        self.path = path
        self.notify = notify
        self._files = files
        counts: Counter[Topic] = Counter()
        for file in files:
            for number, topic in file.channels.items():
                counts[topic] += file.contents.counts[number]
        by_name = sorted(counts.items(), key=lambda item: item[0].name)
        self.channels = tuple(replace(topic, count=count) for topic, count in by_name)
        self.topics = _by_name(self.channels)
        records = (
            MetadataRecord(record.name, tuple(record.metadata.items()))
            for file in files
            for record in file.contents.metadata
        )
        self.records = tuple(dict.fromkeys(records))
        self.start, self.end = self._span()
        self._given: dict[Topic, Topic] = {}

    def _span(self) -> tuple[int, int]:
        """Return (smallest log time, largest log time that is at most LATEST_NS) in ns, and report later log times."""
        extents = [(file, extent) for file in self._files for extent in file.contents.extents]
        start = min((extent.start for _, extent in extents), default=0)
        latest = max((extent.end for _, extent in extents), default=0)
        if latest <= LATEST_NS:
            return start, latest
        self.notify(
            f"{self.path}: a message has the log time {latest * 1e-9:.0f} s, after the year 2262; such messages are "
            "read last, and the duration does not include them"
        )
        return start, max((_plausible_end(file, extent) for file, extent in extents), default=start)

    def close(self) -> None:
        """Close the files."""
        for file in self._files:
            file.close()

    def attachments(self) -> Iterator[AttachedFile]:
        """Yield the files stored inside the bag, such as the parameter file of the run, each once."""
        attached = (attached for file in self._files for attached in file.attachments())
        return iter(dict.fromkeys(attached))

    def define(self, definitions: Path | None) -> None:
        """Set definitions for the topics whose definition the bag lacks, and report these topics.

        Args:
            definitions: folder with the ``.msg`` files of worm_msgs from the time of the recording. None: the
                installed definitions are used later, for each topic that is decoded.

        Raises:
            BagError: A definition in the folder is incomplete, or its type hash differs from the recorded one.
        """
        bare = [c for c in self.channels if c.count and not c.definition]
        defined = [c for c in bare if definitions and _is_defined(c, definitions)]
        self._given = {channel: with_definition(channel, definitions) for channel in defined}
        self.channels = tuple(self._given.get(channel, channel) for channel in self.channels)
        self.topics = _by_name(self.channels)
        self._report_bare(defined, f"those in {definitions} are used")
        rest = [c for c in bare if c not in defined]
        self._report_bare(
            rest, "the installed definitions are used if type hash and length of the messages match"
        )
        if definitions and not defined:
            self.notify(f"{self.path}: {definitions} is not used: {_why_useless(bare)}")

    def _report_bare(self, channels: Sequence[Topic], remedy: str) -> None:
        if channels:
            names = ", ".join(channel.name for channel in channels)
            self.notify(f"{self.path} contains no definitions of {names}; {remedy}")

    def __enter__(self) -> Bag:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def message_count(self) -> int:
        """Number of messages."""
        return sum(topic.count for topic in self.topics.values())

    @property
    def metadata(self) -> dict[str, dict[str, str]]:
        """Last metadata record of each name, such as ``worm_run``; empty if the format has no metadata."""
        return {record.name: dict(record.values) for record in self.records}

    def messages(self, topics: Iterable[str] | None = None) -> Iterator[Message]:
        """Yield the messages in order of log time, lazily, so that memory does not grow with the bag.

        Args:
            topics: names of the topics to read; None: all.

        Raises:
            BagError: A topic does not exist, a file is damaged, or the bag does not contain as many messages as its
                summary declares.
        """
        for block in self.blocks(topics):
            yield from block

    def blocks(self, topics: Iterable[str] | None = None) -> Iterator[Messages]:
        """Yield the messages in blocks. One after the other, the blocks have the order of `messages`."""
        wanted = frozenset(self.topics if topics is None else topics)
        unknown = sorted(wanted - self.topics.keys())
        if unknown:
            raise BagError(
                f"{self.path} has no topic {unknown[0]}; it has {', '.join(self.topics) or 'none'}"
            )
        blocks = self._blocks(wanted) if wanted else iter(())
        return map(self._defined, blocks) if self._given else blocks

    def _defined(self, block: Messages) -> Messages:
        """Return a block with the definitions set by `define`.

        Raises BagError if a message does not have the length that its definition requires.
        """
        is_given = np.array([channel in self._given for channel in block.channels], bool)
        channels = tuple(self._given.get(channel, channel) for channel in block.channels)
        defined = replace(block, channels=channels)
        for message in defined.select(is_given[block.channel]) if is_given.any() else ():
            check_length(message.channel, message.data)
        return defined

    def _blocks(self, topics: frozenset[str]) -> Iterator[Messages]:
        """Yield the messages of some topics in order of log time.

        However long the files are, memory holds only the extents that overlap in time. Small successive extents are
        read together (`mcap_file.TOGETHER_BYTES`).
        """
        extents = [(file, extent) for file in self._files for extent in file.contents.extents]
        # Extents with equal times stay in the order of the files.
        extents.sort(key=lambda item: (item[1].start, item[1].end))
        runs = groupby(extents, key=itemgetter(0))
        count = 0
        for block in merge(
            block for file, run in runs for block in file.blocks((e for _, e in run), topics)
        ):
            count += len(block)
            yield from _decompressed(block)
        expected = sum(channel.count for channel in self.channels if channel.name in topics)
        if count != expected:
            raise BagError(
                f"{self.path} holds {count} messages, but its summary declares {expected}; save the messages "
                f"with: {RECOVER} {self.path}"
            )


def _plausible_end(file: StoredFile, extent: Extent) -> int:
    """Return the largest log time of an extent that is not after LATEST_NS."""
    if extent.end <= LATEST_NS:
        return extent.end
    topics = frozenset(channel.name for channel in file.channels.values())
    times = [block.log_time for _, block in file.blocks([extent], topics)]
    return max((int(t) for part in times for t in part if t <= LATEST_NS), default=extent.start)


def _decompressed(block: Messages) -> Iterator[Messages]:
    """Yield the messages of a block, decompressed; rosbag2's compression mode MESSAGE compresses each message.

    A compressed message begins with the magic number of Zstandard, with which no CDR message begins. If the
    decompressed messages are larger than DECOMPRESSED_BYTES, they are divided into several blocks.
    """
    rows = np.flatnonzero(block.size >= len(zstandard.FRAME_HEADER))
    beginnings = cells(block.buffer, len(zstandard.FRAME_HEADER))[block.offset[rows]]
    if not (beginnings.view("<u4") == int.from_bytes(zstandard.FRAME_HEADER, "little")).any():
        yield block
        return
    messages: list[Message] = []
    size = 0
    for message in block:
        data = _payload(message)
        if messages and size + len(data) > DECOMPRESSED_BYTES:
            yield messages_of(messages)
            messages, size = [], 0
        messages.append(message._replace(data=data))
        size += len(data)
    if messages:
        yield messages_of(messages)


def _payload(message: Message) -> bytes:
    """Return the decompressed payload of a message.

    A payload is returned unchanged if it is not compressed, is damaged, or decompresses to more than LARGEST_CHUNK
    bytes.
    """
    data = message.data
    if data.startswith(zstandard.FRAME_HEADER) and message.channel.encoding == "cdr":
        with suppress(zstandard.ZstdError):
            if zstandard.frame_content_size(data) <= LARGEST_CHUNK:
                return ZstdDecompressor().decompress(data, max_output_size=LARGEST_CHUNK)
    return data


def _by_name(channels: Iterable[Topic]) -> dict[str, Topic]:
    """Return the topics by name, each with its last layout and with the number of its messages in all layouts."""
    topics: dict[str, Topic] = {}
    for channel in sorted(channels, key=lambda c: c.name):
        known = topics.get(channel.name)
        count = channel.count + (known.count if known else 0)
        topics[channel.name] = replace(channel, count=count)
    return topics


def _is_defined(channel: Topic, definitions: Path) -> bool:
    """Return True if a folder with definitions of worm_msgs contains the definition of a topic's type."""
    package, _, kind = channel.type_name.partition("/msg/")
    return package == PACKAGE and (definitions / f"{kind}.msg").is_file()


def _why_useless(bare: Sequence[Topic]) -> str:
    if not bare:
        return "the bag contains the definitions of all its topics"
    missing = ", ".join(sorted({channel.type_name for channel in bare}))
    return f"the folder has no definition of {missing}"
