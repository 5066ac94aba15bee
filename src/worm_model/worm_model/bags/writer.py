# SPDX-License-Identifier: Apache-2.0
"""Writes whole rosbag2 bags (MCAP): the same messages give the same bytes, and a bag is there whole or not at all."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack, suppress
from pathlib import Path
from types import TracebackType
from typing import Any

import yaml
from mcap.writer import CompressionType, Writer

from worm_model.bags.bag import METADATA_FILE, METADATA_ROOT, AttachedFile, Topic
from worm_model.bags.draft import new_folder
from worm_model.bags.errors import UnwritableError

METADATA_VERSION = 9  # ROS 2 Jazzy's
CHUNK_BYTES = 768 * 1024
LIBRARY = "worm_model"
ROSBAG2_RECORD = "rosbag2"


class BagWriter:
    """A bag in the making; a context manager that leaves the bag, or nothing after an exception.

    Args:
        directory: the bag, which must not exist.
        custom: rosbag2's `custom_data`: text by key.

    Raises:
        BagError: the directory exists, or another process is writing it.
        UnwritableError: the system does not let it be made or written.
    """

    def __init__(self, directory: Path, custom: Mapping[str, str] | None = None) -> None:
        self.directory = directory
        self._file = f"{directory.name}_0.mcap"
        self._custom = dict(custom or {})
        self._topics: dict[str, Topic] = {}
        self._schemas: dict[tuple[str, str], int] = {}
        self._channels: dict[str, int] = {}
        self._counts: dict[str, int] = {}
        self._span: tuple[int, int] | None = None
        self._resources = ExitStack()
        try:
            self._draft = self._resources.enter_context(new_folder(directory))
        except OSError as error:
            raise UnwritableError(f"{directory} cannot be written: {error.strerror}") from None
        self._stream = (self._draft / self._file).open("xb")
        self._mcap = Writer(self._stream, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._mcap.start("ros2", LIBRARY)
        self._mcap.add_metadata(ROSBAG2_RECORD, {"serialized_metadata": self._yaml()})

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            with self._resources:  # ends with what is raised in it: then the draft is thrown away
                self._close(error)
        except UnwritableError:
            raise
        except OSError as failure:
            raise UnwritableError(
                f"{self.directory} cannot be written: {failure.strerror}"
            ) from failure

    def _close(self, error: BaseException | None) -> None:
        try:
            if error is not None:
                raise error
            self._finish()
        finally:
            with suppress(OSError):  # what a full disk did not take is still in its buffer
                self._stream.close()

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Keep a metadata record."""
        self._mcap.add_metadata(name, dict(values))

    def add_attachment(self, attached: AttachedFile) -> None:
        """Keep a file inside; it gets no date, so that the bytes do not depend on the day."""
        self._mcap.add_attachment(0, 0, attached.name, attached.media_type, attached.data)

    def add_topic(self, topic: Topic) -> None:
        """Make a topic known before its first message; one without messages is kept too."""
        if topic.name in self._topics:
            return
        key = (topic.type_name, topic.definition)
        if key not in self._schemas:
            self._schemas[key] = self._mcap.register_schema(
                topic.type_name, topic.definition_format, topic.definition.encode()
            )
        self._channels[topic.name] = self._mcap.register_channel(
            topic.name, topic.encoding, self._schemas[key], dict(topic.metadata)
        )
        self._topics[topic.name] = topic
        self._counts[topic.name] = 0

    def write(self, topic: str, data: bytes, log_time: int, publish_time: int) -> None:
        """Append a message of a known topic; times in ns since the epoch."""
        self._mcap.add_message(self._channels[topic], log_time, data, publish_time)
        self._counts[topic] += 1
        first, last = self._span or (log_time, log_time)
        self._span = min(first, log_time), max(last, log_time)

    def _finish(self) -> None:
        self._mcap.flush()
        self._mcap.add_metadata(ROSBAG2_RECORD, {"serialized_metadata": self._yaml()})
        self._mcap.finish()
        self._stream.close()
        text = yaml.safe_dump({METADATA_ROOT: self._document([self._file])}, sort_keys=False)
        (self._draft / METADATA_FILE).write_text(text, encoding="utf-8")

    def _yaml(self) -> str:
        """The copy inside the file, which does not know the file's name: bags of any name have the same bytes."""
        return yaml.safe_dump(self._document([]), sort_keys=False)

    def _document(self, files: list[str]) -> dict[str, Any]:
        """Content of metadata.yaml below its root key."""
        first, last = self._span or (0, 0)
        extent = {
            "duration": {"nanoseconds": last - first},
            "starting_time": {"nanoseconds_since_epoch": first},
            "message_count": sum(self._counts.values()),
        }
        return {
            "version": METADATA_VERSION,
            "storage_identifier": "mcap",
            **extent,
            "topics_with_message_count": [
                {"topic_metadata": _describe(topic), "message_count": self._counts[name]}
                for name, topic in self._topics.items()
            ],
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": files,
            "files": [{"path": name, **_copy(extent)} for name in files],
            "custom_data": self._custom,
            "ros_distro": "jazzy",
        }


def _copy(extent: Mapping[str, Any]) -> dict[str, Any]:
    """A copy that YAML does not take for the same object, which it would write as a reference."""
    return {key: dict(v) if isinstance(v, dict) else v for key, v in extent.items()}


def _describe(topic: Topic) -> dict[str, Any]:
    metadata = dict(topic.metadata)
    try:
        profiles = yaml.safe_load(metadata.get("offered_qos_profiles", "")) or []
    except yaml.YAMLError:
        profiles = []  # of a foreign writer: the channel keeps its text
    return {
        "name": topic.name,
        "type": topic.type_name,
        "serialization_format": topic.encoding,
        "offered_qos_profiles": profiles,
        "type_description_hash": metadata.get("topic_type_hash", ""),
    }
