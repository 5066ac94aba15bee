# SPDX-License-Identifier: Apache-2.0
"""Bag in one or several files, read lazily, extent by extent."""

from __future__ import annotations

import fcntl
import mmap
import sqlite3
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import BinaryIO, cast

import numpy as np
import zstandard
from zstandard import ZstdDecompressor

from worm_model.bags.bag import AttachedFile, Bag, MetadataRecord, Notify
from worm_model.bags.bag_errors import BagError
from worm_model.bags.finding import COMPRESSED, check_readable
from worm_model.bags.formats.contents import Contents, Extent
from worm_model.bags.formats.mcap_records import DAMAGE, LARGEST_CHUNK
from worm_model.bags.formats.message_block import (
    Message,
    Messages,
    Topic,
    cells,
    merge,
    messages_of,
)

LATEST_NS = (1 << 63) - 1  # in the year 2262; later times in ns exceed 64 bits with a sign


@contextmanager
def explained(path: Path) -> Iterator[None]:
    """Convert exceptions of the readers at damaged content to a BagError."""
    try:
        yield
    except BagError:
        raise
    except (*DAMAGE, sqlite3.Error) as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise BagError(
            f"{path} is damaged ({reason}); save its intact part with: worm_model recover {path}"
        ) from None


class StoredFile(ABC):
    """File with messages that is open for reading.

    Args:
        path: the file.

    Attributes:
        data: its bytes.
        contents: its contents without the messages.

    Raises:
        BagError: The file is missing or empty, or cannot be read.
    """

    contents: Contents

    def __init__(self, path: Path) -> None:
        self.path = path
        check_readable(path)
        try:
            self._stream = _unpacked(path) if path.suffix == COMPRESSED else path.open("rb")
            self._map = mmap.mmap(self._stream.fileno(), 0, access=mmap.ACCESS_READ)
        except ValueError:
            self._stream.close()
            raise BagError(f"{path} is empty: nothing was recorded, or its disk was full") from None
        except OSError as error:
            raise BagError(f"{path} cannot be read: {error.strerror}") from None
        self.data = memoryview(self._map)
        try:
            with explained(path):
                self.contents = self._survey()
        except BagError:
            self.close()
            raise

    @abstractmethod
    def _survey(self) -> Contents:
        """Return the contents of the file."""

    @property
    @abstractmethod
    def channels(self) -> Mapping[int, Topic]:
        """Topics by the number of their channel, without their counts."""

    @abstractmethod
    def blocks(
        self, extents: Iterable[Extent], topics: frozenset[str]
    ) -> Iterator[tuple[int, Messages]]:
        """Yield messages of some topics in some extents in order of start, each block with its start (ns)."""

    def attachments(self) -> Iterator[AttachedFile]:
        """Yield the attached files."""
        return iter(())

    def close(self) -> None:
        """Close the file; arrays that were read from it stay valid."""
        with suppress(BufferError):  # arrays still refer to the map, which is closed with them
            self.data.release()
            self._map.close()
        self._stream.close()

    def is_being_written(self) -> bool:
        """Return True if a recorder has the file open at this moment."""
        try:
            fcntl.flock(self._stream, fcntl.LOCK_SH | fcntl.LOCK_NB)
        except OSError:
            return True
        fcntl.flock(self._stream, fcntl.LOCK_UN)
        return False


class StoredBag(Bag):
    """Bag in one or several files, read as one.

    Args:
        path, notify: see `Bag`.
        files: the open files; closed with the bag.
    """

    def __init__(
        self, path: Path, files: Sequence[StoredFile], notify: Notify = lambda _: None
    ) -> None:
        self._files = files
        counts: Counter[Topic] = Counter()
        for file in files:
            for number, topic in file.channels.items():
                counts[topic] += file.contents.counts[number]
        by_name = sorted(counts.items(), key=lambda item: item[0].name)
        channels = tuple(replace(topic, count=count) for topic, count in by_name)
        extents = [(file, extent) for file in files for extent in file.contents.extents]
        start = min((extent.start for _, extent in extents), default=0)
        latest = max((extent.end for _, extent in extents), default=0)
        end = latest
        if latest > LATEST_NS:
            end = max((_plausible_end(file, extent) for file, extent in extents), default=start)
        records = [
            MetadataRecord(record.name, tuple(record.metadata.items()))
            for file in files
            for record in file.contents.metadata
        ]
        super().__init__(path, channels, (start, end), tuple(dict.fromkeys(records)), notify)
        if latest > LATEST_NS:
            notify(
                f"{path}: a message has the log time {latest * 1e-9:.0f} s, after the year 2262; such messages are "
                "read last, and the duration does not include them"
            )

    def close(self) -> None:
        """Close the files."""
        for file in self._files:
            file.close()

    def attachments(self) -> Iterator[AttachedFile]:
        """Yield the attached files, each once even if every MCAP file repeats it."""
        earlier = set()
        for file in self._files:
            for attached in file.attachments():
                if attached not in earlier:
                    earlier.add(attached)
                    yield attached

    def _blocks(self, topics: frozenset[str]) -> Iterator[Messages]:
        """Yield the messages of some topics in order of log time.

        The extents that overlap in time are in memory at the same time, or TOGETHER_BYTES of small ones, regardless
        of the length of the files.
        """
        extents = [(file, extent) for file in self._files for extent in file.contents.extents]
        extents.sort(
            key=lambda item: (item[1].start, item[1].end)
        )  # equal ones in the order of the files
        runs = groupby(extents, key=itemgetter(0))
        count = 0
        for block in merge(
            block for file, run in runs for block in file.blocks((e for _, e in run), topics)
        ):
            count += len(block)
            yield _decompressed(block)
        expected = sum(channel.count for channel in self.channels if channel.name in topics)
        if count != expected:
            raise BagError(
                f"{self.path} holds {count} messages instead of the {expected} that its summary declares; save those "
                f"with: worm_model recover {self.path}"
            )


def _plausible_end(file: StoredFile, extent: Extent) -> int:
    """Return the largest log time of an extent that is not after LATEST_NS."""
    if extent.end <= LATEST_NS:
        return extent.end
    topics = frozenset(channel.name for channel in file.channels.values())
    times = [block.log_time for _, block in file.blocks([extent], topics)]
    return max((int(t) for part in times for t in part if t <= LATEST_NS), default=extent.start)


def _unpacked(path: Path) -> BinaryIO:
    """Return the content of a file that rosbag2 has compressed, up to the first damage, in a temporary file."""
    unpacked = cast(BinaryIO, NamedTemporaryFile())  # noqa: SIM115 - the caller closes it
    with path.open("rb") as packed, suppress(zstandard.ZstdError):
        ZstdDecompressor().copy_stream(packed, unpacked)
    unpacked.flush()
    return unpacked


def _decompressed(block: Messages) -> Messages:
    """Return a block with decompressed messages, which rosbag2 compresses in its compression mode MESSAGE.

    No CDR begins like them.
    """
    rows = np.flatnonzero(block.size >= len(zstandard.FRAME_HEADER))
    beginnings = cells(block.buffer, len(zstandard.FRAME_HEADER))[block.offset[rows]]
    if not (beginnings.view("<u4") == int.from_bytes(zstandard.FRAME_HEADER, "little")).any():
        return block
    return messages_of([m._replace(data=_payload(m)) for m in block])


def _payload(message: Message) -> bytes:
    """Return the decompressed payload of a message; unchanged if it is not compressed, or damaged."""
    data = message.data
    if data.startswith(zstandard.FRAME_HEADER) and message.channel.encoding == "cdr":
        with suppress(zstandard.ZstdError):
            if zstandard.frame_content_size(data) <= LARGEST_CHUNK:
                return ZstdDecompressor().decompress(data, max_output_size=LARGEST_CHUNK)
    return data
