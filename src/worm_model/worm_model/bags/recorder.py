# SPDX-License-Identifier: Apache-2.0
"""Writes raw CDR messages to a rosbag2-compatible MCAP bag that survives its writer's death.

What has been synchronised is on the disk: the open chunk is closed, flushed and fsynced at least every
``Options.sync_s``, so that ``kill -9`` or a power cut costs no more than that. A bag has a provisional metadata.yaml
from the start; `worm_model recover` makes a killed one whole. The file is locked while it is written, so that a reader
can tell a bag in the making from an abandoned one. Nothing is ever overwritten.
"""

from __future__ import annotations

import fcntl
import os
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

from mcap.writer import CompressionType, Writer

from worm_model.bags.bag_metadata import (
    BagSummary,
    Extent,
    RecordedTopic,
    sync_directory,
    write_metadata,
)

COMPRESSIONS = {
    "none": CompressionType.NONE,
    "lz4": CompressionType.LZ4,
    "zstd": CompressionType.ZSTD,
}
LIBRARY = "worm_model record"


class RecorderError(ValueError):
    """A bag cannot be begun, with what to do about it."""


@dataclass(frozen=True)
class Options:
    """How to write.

    Attributes:
        compression: of chunks: ``none`` (rosbag2's default), ``lz4`` or ``zstd``.
        chunk_bytes: a chunk is closed at this size even if no synchronisation is due.
        sync_s: longest time between synchronisations, s.
        split_bytes: begin a new file at about this size; 0: never.
        split_s: begin a new file after this span of log time, s; 0: never.
    """

    compression: str = "zstd"
    chunk_bytes: int = 768 * 1024
    sync_s: float = 0.5
    split_bytes: int = 0
    split_s: float = 0.0

    def __post_init__(self) -> None:
        if self.compression not in COMPRESSIONS:
            raise RecorderError(
                f"unknown compression {self.compression!r}; choose from {', '.join(COMPRESSIONS)}"
            )
        if self.split_bytes < 0 or self.split_s < 0:
            raise RecorderError("a file cannot be split at a negative size or time; 0 means never")


@dataclass(frozen=True)
class Attachment:
    """A file that goes into the bag, such as the parameter file of a run."""

    name: str
    media_type: str
    data: bytes


@dataclass(frozen=True)
class Manifest:
    """What belongs to a run beside its messages; it is repeated in every file of a bag.

    Attributes:
        metadata: MCAP metadata records by name, each of text by key.
        attachments: files kept in the bag.
    """

    metadata: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    attachments: tuple[Attachment, ...] = ()


class BagRecorder:
    """One bag in the making. Not thread-safe: one thread writes.

    Args:
        directory: the bag, a directory that must not exist.
        manifest: what goes into every file of the bag.
        options: how to write.
        now_ns: the time, ns since the epoch; stamp of attachments.
        ros_distro: for metadata.yaml.

    Raises:
        RecorderError: the directory exists.
        OSError: it cannot be made or written.
    """

    def __init__(
        self,
        directory: Path,
        manifest: Manifest,
        options: Options,
        now_ns: int,
        ros_distro: str = "jazzy",
    ) -> None:
        try:
            directory.mkdir(parents=True)
        except FileExistsError:
            raise RecorderError(
                f"{directory} exists already and is not overwritten; choose another name"
            ) from None
        self.directory = directory
        self.summary = BagSummary(custom={"state": "being recorded"}, ros_distro=ros_distro)
        self._options = options
        self._metadata = {name: dict(values) for name, values in manifest.metadata.items()}
        self._attachments = manifest.attachments
        self._now_ns = now_ns
        self._closed_bytes = 0
        self._file = self._open_file()
        write_metadata(directory, self.summary)
        sync_directory(directory.parent)

    @property
    def bytes_written(self) -> int:
        """Size of the bag's files so far, without the open chunk."""
        return self._closed_bytes + self._file.size

    def write(self, topic: RecordedTopic, data: bytes, log_time: int, publish_time: int) -> None:
        """Append a message.

        Args:
            topic: where it came from; its first mention is what the bag keeps of the topic.
            data: CDR, encapsulation header included.
            log_time: when it was received, ns since the epoch.
            publish_time: when it was sent, ns since the epoch.

        Raises:
            OSError: the disk is full or gone; what was synchronised stays.
        """
        if self._file.is_full(self._options, log_time):
            self._split()
        known = self.summary.topics.setdefault(topic.name, topic)
        self._file.write(known, data, log_time, publish_time)
        self.summary.total.add(log_time)
        self.summary.counts[topic.name] = self.summary.counts.get(topic.name, 0) + 1

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Keep a record, such as the gait that has just begun; the last one of a name counts."""
        self._metadata[name] = dict(values)
        self._file.mcap.add_metadata(name, dict(values))

    def sync(self) -> None:
        """Bring all messages to the disk.

        Raises:
            OSError: the disk is full or gone.
        """
        self._file.sync()

    def close(self) -> None:
        """Finish the bag: index, summary and the final metadata.yaml.

        Raises:
            OSError: the disk is full or gone; the bag then wants `worm_model recover`.
        """
        self.summary.custom = {"state": "closed"}
        self._file.finish(self.summary)
        write_metadata(self.directory, self.summary)

    def abandon(self) -> None:
        """Let go of the file as it is, as a crash would."""
        with suppress(OSError):  # what a full disk did not take is still in its buffer
            self._file.stream.close()

    def _split(self) -> None:
        self._file.finish(self.summary)
        self._closed_bytes += self._file.size
        self._file = self._open_file()
        write_metadata(self.directory, self.summary)

    def _open_file(self) -> _File:
        name = f"{self.directory.name}_{len(self.summary.files)}.mcap"
        extent = self.summary.files.setdefault(name, Extent())
        file = _File(self.directory / name, self._options, extent)
        file.mcap.start("ros2", LIBRARY)
        file.mcap.add_metadata("rosbag2", {"serialized_metadata": self.summary.text()})
        for record, values in self._metadata.items():
            file.mcap.add_metadata(record, values)
        for attachment in self._attachments:
            file.mcap.add_attachment(
                self._now_ns, self._now_ns, attachment.name, attachment.media_type, attachment.data
            )
        file.sync()
        return file


class _File:
    """One MCAP file of a bag."""

    def __init__(self, path: Path, options: Options, extent: Extent) -> None:
        self.stream: BinaryIO = path.open("xb")
        fcntl.flock(
            self.stream, fcntl.LOCK_EX | fcntl.LOCK_NB
        )  # held until the writer closes or dies
        self.mcap = Writer(
            self.stream,
            chunk_size=options.chunk_bytes,
            compression=COMPRESSIONS[options.compression],
        )
        self._extent = extent
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._size_at_end = 0

    @property
    def size(self) -> int:
        """Bytes written so far; what is in the open chunk is not."""
        return self._size_at_end if self.stream.closed else self.stream.tell()

    def is_full(self, options: Options, log_time: int) -> bool:
        """Whether a message of that log time (ns) belongs into the next file."""
        if not self._extent.count:
            return False  # a file has at least one message
        by_size = 0 < options.split_bytes <= self.size
        by_time = 0 < options.split_s * 1e9 <= log_time - self._extent.first
        return by_size or by_time

    def write(self, topic: RecordedTopic, data: bytes, log_time: int, publish_time: int) -> None:
        """Append a message; schema and channel go before their first one."""
        channel = self._channels.get(topic.name)
        if channel is None:
            channel = self._register(topic)
        self.mcap.add_message(channel, log_time, data, publish_time)
        self._extent.add(log_time)

    def _register(self, topic: RecordedTopic) -> int:
        if topic.type_name not in self._schemas:
            self._schemas[topic.type_name] = self.mcap.register_schema(
                topic.type_name, "ros2msg", topic.schema.encode()
            )
        metadata = {"offered_qos_profiles": topic.qos_yaml(), "topic_type_hash": topic.type_hash}
        channel = self.mcap.register_channel(
            topic.name, "cdr", self._schemas[topic.type_name], metadata
        )
        self._channels[topic.name] = channel
        return channel

    def sync(self) -> None:
        """Close the open chunk and bring it to the disk."""
        self.mcap.flush()
        os.fsync(self.stream.fileno())

    def finish(self, summary: BagSummary) -> None:
        """Write the index and close."""
        self.mcap.flush()
        self.mcap.add_metadata("rosbag2", {"serialized_metadata": summary.text()})
        self.mcap.finish()
        self.stream.flush()
        os.fsync(self.stream.fileno())
        self._size_at_end = self.stream.tell()
        self.stream.close()
