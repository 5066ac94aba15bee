# SPDX-License-Identifier: Apache-2.0
"""Writes whole rosbag2 bags (MCAP): the same messages give the same bytes, and a bag is there whole or not at all."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack, suppress
from functools import lru_cache
from pathlib import Path
from textwrap import indent
from types import TracebackType
from typing import Any

import numpy as np
import yaml

from worm_model.bags.bag import (
    METADATA_FILE,
    METADATA_ROOT,
    YAML_LOADER,
    AttachedFile,
    Message,
    Topic,
)
from worm_model.bags.bag_errors import UnwritableError
from worm_model.bags.blocks import MessageBlock
from worm_model.bags.draft import new_folder
from worm_model.bags.mcap_writer import CHUNK_BYTES, McapWriter
from worm_model.bags.payloads import payloads_of

METADATA_VERSION = 9  # ROS 2 Jazzy's
WAITING = 1000  # single messages that are put together
LIBRARY = "worm_model"
YAML_DUMPER: Any = getattr(yaml, "CSafeDumper", yaml.SafeDumper)  # the one in C is faster
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
        self._waiting: list[Message] = []
        self._waiting_bytes = 0
        with ExitStack() as resources:
            try:
                self._draft = resources.enter_context(new_folder(directory))
                self._stream = (self._draft / self._file).open("xb")
                self._mcap = McapWriter(self._stream, LIBRARY)
                provisional = self._text(self._topics_text(), [])
                self._mcap.add_metadata(ROSBAG2_RECORD, {"serialized_metadata": provisional})
            except OSError as error:
                raise UnwritableError(f"{directory} cannot be written: {error.strerror}") from None
            self._resources = resources.pop_all()

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
            self._mcap.close()
            with suppress(OSError):  # what a full disk did not take is still in its buffer
                self._stream.close()

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Keep a metadata record."""
        self._mcap.add_metadata(name, values)

    def add_attachment(self, attached: AttachedFile) -> None:
        """Keep a file inside; it gets no date, so that the bytes do not depend on the day."""
        self._mcap.add_attachment(attached.name, attached.media_type, attached.data)

    def add_topic(self, topic: Topic) -> None:
        """Make a topic known before its first message; one without messages is kept too."""
        if topic.name in self._topics:
            return
        key = (topic.type_name, topic.definition)
        if key not in self._schemas:
            self._schemas[key] = self._mcap.add_schema(
                topic.type_name, topic.definition_format, topic.definition.encode()
            )
        self._channels[topic.name] = self._mcap.add_channel(
            topic.name, topic.encoding, self._schemas[key], dict(topic.metadata)
        )
        self._topics[topic.name] = topic

    def write(self, topic: str, data: bytes, log_time: int, publish_time: int) -> None:
        """Append a message of a known topic; times in ns since the epoch."""
        if topic not in self._channels:
            raise KeyError(topic)
        self._waiting.append(Message(topic, log_time, data, publish_time))
        self._waiting_bytes += len(data)
        if len(self._waiting) >= WAITING or self._waiting_bytes >= CHUNK_BYTES:
            self._write_waiting()

    def write_block(self, block: MessageBlock) -> None:
        """Append messages of known topics."""
        self._write_waiting()
        channels = np.array([self._channels[name] for name in block.names], dtype=np.int64)
        self._mcap.write(channels[block.topic], block.payloads, block.publish_time)

    def _write_waiting(self) -> None:
        messages, self._waiting, self._waiting_bytes = self._waiting, [], 0
        channel = np.array([self._channels[m.topic] for m in messages], dtype=np.int64)
        payloads = payloads_of([m.data for m in messages], [m.log_time for m in messages])
        publish_time = np.array([m.publish_time for m in messages], dtype=np.uint64)
        self._mcap.write(channel, payloads, publish_time)

    def _finish(self) -> None:
        self._write_waiting()
        self._mcap.end_chunk()  # which is compressed meanwhile
        topics = self._topics_text()
        inside, beside = self._text(topics, []), self._text(topics, [self._file])
        self._mcap.add_metadata(ROSBAG2_RECORD, {"serialized_metadata": inside})
        self._mcap.finish()
        self._stream.close()
        text = f"{METADATA_ROOT}:\n{indent(beside, '  ')}"
        (self._draft / METADATA_FILE).write_text(text, encoding="utf-8")

    def _text(self, topics: str, files: list[str]) -> str:
        """Content of metadata.yaml below its root key.

        The copy inside the file does not know the file's name: bags of any name have the same bytes.
        """
        statistics = self._mcap.statistics()
        first, last = statistics.message_start_time, statistics.message_end_time
        extent = {
            "duration": {"nanoseconds": last - first},
            "starting_time": {"nanoseconds_since_epoch": first},
            "message_count": statistics.message_count,
        }
        head = {"version": METADATA_VERSION, "storage_identifier": "mcap", **extent}
        tail = {
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": files,
            "files": [{"path": name, **extent} for name in files],
            "custom_data": self._custom,
            "ros_distro": "jazzy",
        }
        return _dump(head) + topics + _dump(tail)

    def _topics_text(self) -> str:
        """The topics in metadata.yaml, which are most of it."""
        counts = self._mcap.statistics().channel_message_counts
        topics = [
            {
                "topic_metadata": _describe(topic),
                "message_count": counts.get(self._channels[name], 0),
            }
            for name, topic in self._topics.items()
        ]
        return _dump({"topics_with_message_count": topics})


class _Dumper(YAML_DUMPER):
    """Repeats an object that occurs several times, where YAML would refer to its first occurrence."""

    def ignore_aliases(self, data: Any) -> bool:  # noqa: ARG002 - of any
        return True


def _dump(document: dict[str, Any]) -> str:
    return yaml.dump(document, Dumper=_Dumper, sort_keys=False)


def _describe(topic: Topic) -> dict[str, Any]:
    metadata = dict(topic.metadata)
    return {
        "name": topic.name,
        "type": topic.type_name,
        "serialization_format": topic.encoding,
        "offered_qos_profiles": _profiles(metadata.get("offered_qos_profiles", "")),
        "type_description_hash": metadata.get("topic_type_hash", ""),
    }


@lru_cache(maxsize=64)
def _profiles(text: str) -> Any:
    try:
        return yaml.load(text, Loader=YAML_LOADER) or []
    except yaml.YAMLError:
        return []  # of a foreign writer: the channel keeps its text
