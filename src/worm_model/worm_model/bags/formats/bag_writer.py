# SPDX-License-Identifier: Apache-2.0
"""Writer of rosbag2 bags (MCAP); all programs that write bags use it, including the recorder."""

from __future__ import annotations

import fcntl
import os
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from mcap.writer import CompressionType, Writer

from worm_model.bags.formats.bag import Bag
from worm_model.bags.formats.bag_errors import UnwritableError
from worm_model.bags.formats.bag_metadata import Extent, metadata_text, write_metadata
from worm_model.bags.formats.contents import AttachedFile
from worm_model.bags.formats.message_block import Message, Topic
from worm_model.bags.formats.whole_folder import new_folder
from worm_model.errors import printable

COMPRESSIONS = {
    "none": CompressionType.NONE,
    "lz4": CompressionType.LZ4,
    "zstd": CompressionType.ZSTD,
}
LIBRARY = "worm_model"
ROSBAG2_RECORD = "rosbag2"  # metadata record with a copy of metadata.yaml


@dataclass(frozen=True)
class WriteOptions:
    """Options of writing.

    Attributes:
        compression: compression of chunks: ``none`` (rosbag2's default), ``lz4`` or ``zstd``.
        chunk_bytes: size at which a chunk is closed even if no synchronisation is due.
        split_bytes: approximate size at which a new file begins; 0: never.
        split_s: span of log time after which a new file begins, s; 0: never.
    """

    compression: str = "zstd"
    chunk_bytes: int = 768 * 1024
    split_bytes: int = 0
    split_s: float = 0.0


class BagFiles:
    """MCAP files of a bag and its metadata.yaml in an existing folder. Not thread-safe.

    Args:
        directory: folder of the files.
        name: name of the bag, with which the names of its files begin.
        options: options of writing.
        custom: rosbag2's `custom_data`: text by key.
        synchronise: writes an open file, given by its descriptor, to the disk.

    Raises:
        OSError: In all methods, if the disk is full or missing; synchronised data is preserved.
    """

    def __init__(
        self,
        directory: Path,
        name: str,
        options: WriteOptions | None = None,
        custom: Mapping[str, str] | None = None,
        synchronise: Callable[[int], None] = os.fsync,
    ) -> None:
        self.directory = directory
        self._synchronise = synchronise
        self.custom = dict(custom or {})
        self.counts: Counter[Topic] = Counter()
        self._name = printable(name)
        self._options = options or WriteOptions()
        self._total = Extent()
        self._extents: dict[str, Extent] = {}
        self._metadata: dict[str, dict[str, str]] = {}
        self._attachments: list[AttachedFile] = []
        self._file = self._open()

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Add a metadata record; every later file repeats the last record of each name."""
        self._metadata[name] = dict(values)
        self._file.mcap.add_metadata(name, dict(values))

    def add_attachment(self, attached: AttachedFile) -> None:
        """Add an attached file to the present file of the bag and to all later ones.

        The attachment has no date, so that equal content produces equal bytes.
        """
        self._attachments.append(attached)
        self._file.attach(attached)

    def add_topic(self, topic: Topic) -> None:
        """Add a topic; the bag lists it even without messages."""
        self.counts.setdefault(topic, 0)
        self._file.channel(topic)

    def write(self, topic: Topic, data: bytes, log_time: int, publish_time: int) -> None:
        """Append a message.

        Args:
            topic: its topic.
            data: CDR with its encapsulation header.
            log_time, publish_time: times of reception and sending, ns since the epoch.
        """
        if self._file.is_full(self._options, log_time):
            self.split()
        self._file.write(topic, data, log_time, publish_time)
        self._total.add(log_time)
        self.counts[topic] += 1

    def write_all(self, messages: Iterable[Message]) -> int:
        """Append messages, each with its own definition; return their number."""
        before = self._total.count
        for message in messages:
            self.write(message.channel, message.data, message.log_time, message.publish_time)
        return self._total.count - before

    def copy_records(self, bag: Bag) -> None:
        """Copy the attachments and metadata records of a bag, except rosbag2's copy of metadata.yaml."""
        for attached in bag.attachments():
            self.add_attachment(attached)
        for record in bag.records:
            if record.name != ROSBAG2_RECORD:
                self.add_metadata(record.name, dict(record.values))

    def split(self) -> None:
        """Finish the present file and continue in a new one."""
        self._file.finish(self._text({}))
        self._file = self._open()
        self.describe()

    def sync(self) -> None:
        """Write all messages to the disk."""
        self._file.sync()

    def describe(self) -> None:
        """Write a metadata.yaml that describes the present state of the bag."""
        write_metadata(self.directory, self._text(self._extents), self._synchronise)

    def finish(self) -> None:
        """Write the remaining data, the index and the final metadata.yaml."""
        self._file.finish(self._text({}))
        self.describe()

    def abandon(self) -> None:
        """Close the open file in its present state, as after a crash."""
        with suppress(OSError):  # the buffer still contains bytes for which the disk had no space
            self._file.stream.close()

    def _text(self, files: Mapping[str, Extent]) -> str:
        """Return the content of metadata.yaml.

        The copy inside an MCAP file lists no files, so that the bytes of that file do not depend on the bag's name.
        """
        counts: dict[str, tuple[Topic, int]] = {}
        for topic, count in self.counts.items():
            _, before = counts.get(topic.name, (topic, 0))
            counts[topic.name] = topic, before + count
        return metadata_text(self._total, counts.values(), files, self.custom)

    def _open(self) -> _OpenFile:
        name = f"{self._name}_{len(self._extents)}.mcap"
        extent = self._extents.setdefault(name, Extent())
        file = _OpenFile(self.directory / name, self._options, extent, self._synchronise)
        file.mcap.start("ros2", LIBRARY)
        file.mcap.add_metadata(ROSBAG2_RECORD, {"serialized_metadata": self._text({})})
        for record, values in self._metadata.items():
            file.mcap.add_metadata(record, values)
        for attached in self._attachments:
            file.attach(attached)
        file.sync()
        return file


class _OpenFile:
    """MCAP file that is being written; its lock distinguishes it from an abandoned file."""

    def __init__(
        self,
        path: Path,
        options: WriteOptions,
        extent: Extent,
        synchronise: Callable[[int], None],
    ) -> None:
        self.path = path
        self._synchronise = synchronise
        self.stream: BinaryIO = path.open("xb")
        # The lock ends when the writer closes the file or dies.
        fcntl.flock(self.stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        self.mcap = Writer(
            self.stream,
            chunk_size=options.chunk_bytes,
            compression=COMPRESSIONS[options.compression],
            enable_data_crcs=True,  # nothing else protects metadata records
        )
        self._extent = extent
        self._schemas: dict[tuple[str, str], int] = {}
        self._channels: dict[Topic, int] = {}

    @property
    def is_there(self) -> bool:
        """True if the file still exists under its name."""
        try:
            return os.path.samestat(os.fstat(self.stream.fileno()), self.path.stat())
        except OSError:
            return False

    def is_full(self, options: WriteOptions, log_time: int) -> bool:
        """Return True if a message with this log time (ns) belongs in the next file."""
        if not self._extent.count:
            return False  # a file has at least one message
        by_size = 0 < options.split_bytes <= self.stream.tell()  # the open chunk does not count
        by_time = 0 < options.split_s * 1e9 <= log_time - self._extent.first
        return by_size or by_time

    def attach(self, attached: AttachedFile) -> None:
        """Add an attached file."""
        self.mcap.add_attachment(0, 0, attached.name, attached.media_type, attached.data)

    def channel(self, topic: Topic) -> int:
        """Return the channel number of a topic; the first call writes its schema and channel."""
        known = self._channels.get(topic)
        if known is not None:
            return known
        schema = (topic.type_name, topic.definition)
        if topic.type_name and schema not in self._schemas:
            self._schemas[schema] = self.mcap.register_schema(
                topic.type_name, topic.definition_format, topic.definition.encode()
            )
        self._channels[topic] = self.mcap.register_channel(
            topic.name, topic.encoding, self._schemas.get(schema, 0), dict(topic.metadata)
        )
        return self._channels[topic]

    def write(self, topic: Topic, data: bytes, log_time: int, publish_time: int) -> None:
        """Append a message."""
        self.mcap.add_message(self.channel(topic), log_time, data, publish_time)
        self._extent.add(log_time)

    def sync(self) -> None:
        """Close the open chunk and write it to the disk."""
        self.mcap.flush()
        self._synchronise(self.stream.fileno())

    def finish(self, text: str) -> None:
        """Write the index and close the file."""
        self.mcap.flush()
        self.mcap.add_metadata(ROSBAG2_RECORD, {"serialized_metadata": text})
        self.mcap.finish()
        self.stream.flush()
        self._synchronise(self.stream.fileno())
        self.stream.close()


@contextmanager
def new_bag(directory: Path, custom: Mapping[str, str] | None = None) -> Iterator[BagFiles]:
    """Yield a new bag for writing. The bag appears when the context ends; after an exception, nothing remains.

    Equal content produces MCAP files with equal bytes.

    Args:
        directory: the bag, which must not exist.
        custom: rosbag2's `custom_data`: text by key.

    Raises:
        BagError: The directory exists, or another process is writing it.
        UnwritableError: The operating system cannot create or write the directory.
    """
    try:
        with new_folder(directory) as unfinished:
            # new_folder writes the complete folder to the disk at the end.
            files = BagFiles(unfinished, directory.name, custom=custom, synchronise=lambda _: None)
            try:
                yield files
                files.finish()
            finally:
                files.abandon()
    except UnwritableError:
        raise
    except OSError as error:
        raise UnwritableError(f"{directory} cannot be written: {error.strerror}") from error
