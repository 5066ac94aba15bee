# SPDX-License-Identifier: Apache-2.0
"""Writer of rosbag2 bags (MCAP); all programs that write bags use it, including the recorder."""

from __future__ import annotations

import errno
import os
import shutil
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from mcap.writer import CompressionType, Writer

from worm_model.bags.formats.bag_errors import ExistsError, UnwritableError
from worm_model.bags.formats.bag_metadata import LogTimes, metadata_text, write_metadata
from worm_model.bags.formats.message_block import Message, Topic
from worm_model.bags.formats.stored_file import AttachedFile
from worm_model.errors import printable

CHUNK_BYTES = 768 * 1024  # size at which a chunk is closed even if no synchronisation is due
LIBRARY = "worm_model"
ROSBAG2_RECORD = "rosbag2"  # metadata record with a copy of metadata.yaml


class BagWriter:
    """MCAP file of a bag and its metadata.yaml in an existing folder. Not thread-safe.

    Args:
        directory: folder of the file.
        name: name of the bag, with which the name of its file begins.
        custom: rosbag2's `custom_data`: text by key.
    """

    def __init__(self, directory: Path, name: str, custom: Mapping[str, str] | None = None) -> None:
        self.directory = directory
        self.custom = dict(custom or {})
        self.path = directory / f"{printable(name)}_0.mcap"
        self._counts: Counter[Topic] = Counter()
        self._extent = LogTimes()
        self._schemas: dict[tuple[str, str], int] = {}
        self._channels: dict[Topic, int] = {}
        self._stream: BinaryIO = self.path.open("xb")
        self._mcap = Writer(
            self._stream,
            chunk_size=CHUNK_BYTES,
            compression=CompressionType.ZSTD,
            enable_data_crcs=True,  # nothing else protects metadata records
        )
        self._mcap.start("ros2", LIBRARY)
        self._mcap.add_metadata(ROSBAG2_RECORD, {"serialized_metadata": self._text({})})
        self.sync()

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Add a metadata record."""
        self._mcap.add_metadata(name, dict(values))

    def add_attachment(self, attached: AttachedFile) -> None:
        """Add an attached file. It has no date, so that equal content produces equal bytes."""
        self._mcap.add_attachment(0, 0, attached.name, attached.media_type, attached.data)

    def add_topic(self, topic: Topic) -> None:
        """Add a topic; the bag lists it even without messages."""
        self._counts.setdefault(topic, 0)
        self._channel(topic)

    def write(self, topic: Topic, data: bytes, log_time: int, publish_time: int) -> None:
        """Append a message.

        Args:
            topic: its topic.
            data: CDR with its encapsulation header.
            log_time, publish_time: times of reception and sending, ns since the epoch.
        """
        self._mcap.add_message(self._channel(topic), log_time, data, publish_time)
        self._extent.add(log_time)
        self._counts[topic] += 1

    def write_all(self, messages: Iterable[Message]) -> int:
        """Append messages, each with its own definition; return their number."""
        before = self._extent.count
        for message in messages:
            self.write(message.channel, message.data, message.log_time, message.publish_time)
        return self._extent.count - before

    def sync(self) -> None:
        """Close the open chunk, and write all messages to the disk."""
        self._mcap.flush()
        os.fsync(self._stream.fileno())

    def describe(self) -> None:
        """Write a metadata.yaml that describes the present state of the bag."""
        write_metadata(self.directory, self._text({self.path.name: self._extent}))

    def finish(self) -> None:
        """Write the remaining data, the index and the final metadata.yaml."""
        self._mcap.flush()
        self._mcap.add_metadata(ROSBAG2_RECORD, {"serialized_metadata": self._text({})})
        self._mcap.finish()
        self._stream.flush()
        os.fsync(self._stream.fileno())
        self._stream.close()
        self.describe()

    def abandon(self) -> None:
        """Close the open file in its present state, as after a crash."""
        with suppress(OSError):  # the buffer still contains bytes for which the disk had no space
            self._stream.close()

    def _text(self, files: Mapping[str, LogTimes]) -> str:
        """Return the content of metadata.yaml.

        The copy inside an MCAP file lists no files, so that the bytes of that file do not depend on the bag's name.
        """
        counts: dict[str, tuple[Topic, int]] = {}
        for topic, count in self._counts.items():
            _, before = counts.get(topic.name, (topic, 0))
            counts[topic.name] = topic, before + count
        return metadata_text(self._extent, counts.values(), files, self.custom)

    def _channel(self, topic: Topic) -> int:
        """Return the channel number of a topic; the first call writes its schema and channel."""
        known = self._channels.get(topic)
        if known is not None:
            return known
        schema = (topic.type_name, topic.definition)
        if topic.type_name and schema not in self._schemas:
            self._schemas[schema] = self._mcap.register_schema(
                topic.type_name, topic.definition_format, topic.definition.encode()
            )
        self._channels[topic] = self._mcap.register_channel(
            topic.name, topic.encoding, self._schemas.get(schema, 0), dict(topic.metadata)
        )
        return self._channels[topic]


@contextmanager
def new_bag(directory: Path) -> Iterator[BagWriter]:
    """Yield a new bag for writing. The bag appears when the context ends; after an exception, nothing remains.

    Equal content produces MCAP files with equal bytes.

    Args:
        directory: the bag, which must not exist.
    """
    try:
        with new_folder(directory) as unfinished:
            writer = BagWriter(unfinished, directory.name)
            try:
                yield writer
                writer.finish()
            finally:
                writer.abandon()
    except UnwritableError:
        raise
    except OSError as error:
        raise UnwritableError(f"{directory} cannot be written: {error.strerror}") from error


@contextmanager
def new_folder(target: Path) -> Iterator[Path]:
    """Yield a temporary folder that is renamed to the target when the context ends, or removed after an exception."""
    if target.exists():
        raise ExistsError(f"{target} exists already and is not overwritten; choose another name")
    unfinished = target.with_name(f".{target.name}.{os.getpid()}")
    unfinished.mkdir(parents=True)
    try:
        yield unfinished
        unfinished.rename(target)  # replaces an empty folder, and fails if the folder has content
    except OSError as error:
        if error.errno not in (errno.ENOTEMPTY, errno.EEXIST, errno.ENOTDIR):
            raise
        raise ExistsError(
            f"{target} exists already: another process has created it; choose another name"
        ) from None
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)
