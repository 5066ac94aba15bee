# SPDX-License-Identifier: Apache-2.0
"""A bag that lies in one or several MCAP files, read lazily, extent by extent."""

from __future__ import annotations

import fcntl
import mmap
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from worm_model.bags.bag import AttachedFile, Bag, MetadataRecord, Notify
from worm_model.bags.bag_errors import BagError
from worm_model.bags.mcap_scan import (
    DAMAGE,
    HEAD,
    MAGIC,
    MESSAGE_BODY,
    Extent,
    extent_records,
    message_heads,
    read_attachment,
    scan,
)
from worm_model.bags.message_block import Messages, Topic, merge

TOGETHER_BYTES = 1 << 20  # of small extents: numpy costs the same for one as for many


@contextmanager
def explained(path: Path) -> Iterator[None]:
    """Turn what the readers raise at damaged content into a BagError."""
    try:
        yield
    except BagError:
        raise
    except DAMAGE as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise BagError(
            f"{path} is damaged ({reason}); worm_model recover saves what is whole"
        ) from None


class McapFile:
    """An MCAP file that is open for reading.

    Args:
        path: the file.

    Raises:
        BagError: it is missing, empty, or no MCAP file.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self._stream = path.open("rb")
            self._map = mmap.mmap(self._stream.fileno(), 0, access=mmap.ACCESS_READ)
        except ValueError:
            self._stream.close()
            raise BagError(f"{path} is empty: nothing was recorded, or its disk was full") from None
        except OSError as error:
            raise BagError(f"{path} cannot be read: {error.strerror}") from None
        self.data = memoryview(self._map)
        self.size = len(self.data)
        if self.data[: len(MAGIC)] != MAGIC:
            first = bytes(self.data[: len(MAGIC)])
            self.close()
            raise BagError(f"{path} is not an MCAP file: its first bytes are {first!r}")
        self.contents = scan(self.data)

    @property
    def channels(self) -> dict[int, Topic]:
        """Topics by the number of their channel, without their counts."""
        topics = {}
        for number, channel in sorted(self.contents.channels.items()):
            schema = self.contents.schemas.get(channel.schema_id)
            topics[number] = Topic(
                name=channel.topic,
                type_name=schema.name if schema else "",
                count=0,
                definition=schema.data.decode(errors="replace") if schema else "",
                definition_format=schema.encoding if schema else "",
                encoding=channel.message_encoding,
                metadata=tuple(channel.metadata.items()),
            )
        return topics

    def close(self) -> None:
        """Close the file; what was read from it stays."""
        with suppress(BufferError):  # arrays hold it still: it goes with them
            self.data.release()
            self._map.close()
        self._stream.close()

    def blocks(
        self, extents: Iterable[Extent], topics: frozenset[str]
    ) -> Iterator[tuple[int, Messages]]:
        """Messages of some topics in some extents by rising start, each block with its start (ns).

        Small extents that follow each other are one block: a recorder that synchronises often leaves many.
        """
        start, size = 0, 0
        parts: list[tuple[Extent, bytes | memoryview]] = []
        with explained(self.path):
            for extent in extents:
                records = extent_records(self.data, extent)
                if parts and size + len(records) > TOGETHER_BYTES:
                    yield start, self._messages(parts, topics)
                    parts, size = [], 0
                start = start if parts else extent.start
                parts.append((extent, records))
                size += len(records)
            if parts:
                yield start, self._messages(parts, topics)

    def _messages(
        self, parts: Sequence[tuple[Extent, bytes | memoryview]], topics: frozenset[str]
    ) -> Messages:
        """Messages of some topics, in the order of the file."""
        records = b"".join(part for _, part in parts) if len(parts) > 1 else parts[0][1]
        offset, heads = message_heads(records)
        numbers = heads["channel"].astype(np.int64)
        self._check(parts, numbers, heads)
        channels = self.channels
        lookup = np.full(1 << 16, -1)
        lookup[list(channels)] = range(len(channels))
        channel = lookup[numbers]
        if (channel < 0).any():
            raise ValueError("a message is of an unknown channel")
        wanted = np.array([topic.name in topics for topic in channels.values()], bool)
        rows = np.flatnonzero(wanted[channel]) if len(channel) else channel
        return Messages(
            tuple(channels.values()),
            np.frombuffer(records, np.uint8),
            channel[rows],
            offset[rows] + HEAD.itemsize,
            heads["length"][rows].astype(np.int64) - MESSAGE_BODY,
            heads["log_time"][rows].astype(np.uint64),
            heads["publish_time"][rows].astype(np.uint64),
        )

    def _check(
        self,
        parts: Sequence[tuple[Extent, bytes | memoryview]],
        numbers: NDArray[Any],
        heads: NDArray[Any],
    ) -> None:
        """Compare messages with the indexes of their chunks, and with the span of these."""
        if all(extent.counts is not None for extent, _ in parts):
            expected: Counter[int] = Counter()
            for extent, _ in parts:
                expected.update(extent.counts or {})
            if Counter(numbers.tolist()) != expected:
                raise ValueError("its chunks hold other messages than their indexes tell")
        times = heads["log_time"]
        if len(times) and not (
            min(extent.start for extent, _ in parts) <= int(times.min())
            and int(times.max()) <= max(extent.end for extent, _ in parts)
        ):
            raise ValueError("a message lies outside of the time span of its chunk")

    def attachments(self) -> Iterator[AttachedFile]:
        """The files kept inside."""
        for place in self.contents.attachments:
            with explained(self.path):
                attached = read_attachment(self.data, place)
            yield AttachedFile(attached.name, attached.media_type, attached.data)

    def is_being_written(self) -> bool:
        """Whether a recorder holds the file at this moment."""
        try:
            fcntl.flock(self._stream, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except OSError:
            return True
        fcntl.flock(self._stream, fcntl.LOCK_UN)
        return False


class McapBag(Bag):
    """Reads MCAP files as one.

    Args:
        path, notify: as `Bag` has them.
        files: the open files; closed with the bag.
    """

    def __init__(
        self, path: Path, files: Sequence[McapFile], notify: Notify = lambda _: None
    ) -> None:
        self._files = files
        counts: Counter[Topic] = Counter()
        for file in files:
            for number, topic in file.channels.items():
                counts[topic] += file.contents.counts[number]
        by_name = sorted(counts.items(), key=lambda item: item[0].name)
        channels = tuple(replace(topic, count=count) for topic, count in by_name)
        extents = [extent for file in files for extent in file.contents.extents]
        start = min((extent.start for extent in extents), default=0)
        span = start, max((extent.end for extent in extents), default=0)
        records = [
            MetadataRecord(record.name, tuple(record.metadata.items()))
            for file in files
            for record in file.contents.metadata
        ]
        super().__init__(path, channels, span, tuple(dict.fromkeys(records)), notify)

    def close(self) -> None:
        """Close the files."""
        for file in self._files:
            file.close()

    def attachments(self) -> Iterator[AttachedFile]:
        """Files kept inside, each once even if every MCAP file repeats it."""
        earlier = set()
        for file in self._files:
            for attached in file.attachments():
                if attached not in earlier:
                    earlier.add(attached)
                    yield attached

    def _blocks(self, topics: frozenset[str]) -> Iterator[Messages]:
        """Messages of some topics by rising log time.

        What is in memory at a time is the extents that overlap in time, or TOGETHER_BYTES of small ones, however long
        the files are.
        """
        extents = [(file, extent) for file in self._files for extent in file.contents.extents]
        extents.sort(key=lambda item: (item[1].start, item[1].end))  # equal ones as in the files
        runs = groupby(extents, key=itemgetter(0))
        count = 0
        for block in merge(
            block for file, run in runs for block in file.blocks((e for _, e in run), topics)
        ):
            count += len(block)
            yield block
        expected = sum(channel.count for channel in self.channels if channel.name in topics)
        if count != expected:
            raise BagError(
                f"{self._files[0].path} and what belongs to it hold {count} messages instead of {expected}; "
                "worm_model recover saves what is whole"
            )
