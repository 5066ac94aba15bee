# SPDX-License-Identifier: Apache-2.0
"""Bags with compressed files or messages, read by the library `rosbags`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from types import MappingProxyType

from rosbags.interfaces import (
    Connection,
    ConnectionExtRosbag2,
    MessageDefinitionFormat,
)
from rosbags.rosbag2 import Reader
from rosbags.rosbag2.metadata import dump_qos_v9

from worm_model.bags.bag import AttachedFile, Bag, Notify
from worm_model.bags.bag_errors import BagError
from worm_model.bags.formats.bag_metadata import dump_yaml
from worm_model.bags.formats.message_block import Message, Messages, Topic, messages_of

BATCH = 1000
_FORMATS = MappingProxyType(
    {
        MessageDefinitionFormat.MSG: "ros2msg",
        MessageDefinitionFormat.IDL: "ros2idl",
        MessageDefinitionFormat.NONE: "",
    }
)


@contextmanager
def _explained(path: Path) -> Iterator[None]:
    """Convert any exception of the library for invalid content to a BagError, including failed assertions."""
    try:
        yield
    except Exception as error:  # noqa: BLE001
        reason = " ".join(str(error).split()) or type(error).__name__
        raise BagError(f"{path} cannot be read: {reason}") from None


class RosbagsBag(Bag):
    """Bag read by `rosbags`, which supports neither metadata records nor attachments.

    Args:
        path: rosbag2 directory.
        notify: see `Bag`.

    Raises:
        BagError: The bag cannot be read.
    """

    def __init__(self, path: Path, notify: Notify) -> None:
        with _explained(path):
            self._reader = Reader(path)
            self._reader.open()
            channels = tuple(map(_topic, self._reader.connections))
            empty = not self._reader.message_count
            span = (0, 0) if empty else (self._reader.start_time, self._reader.end_time - 1)
        super().__init__(path, channels, span, (), notify)

    def close(self) -> None:
        """Close the files."""
        self._reader.close()

    def attachments(self) -> Iterator[AttachedFile]:
        """Return an empty iterator, because the format has no attachments."""
        return iter(())

    def _blocks(self, topics: frozenset[str]) -> Iterator[Messages]:
        """Yield the messages of some topics in order of log time; the unknown publish time is set to the log time."""
        wanted = [c for c in self._reader.connections if c.topic in topics]
        channels = {c.id: _topic(c) for c in wanted}
        count = 0
        with _explained(self.path):
            messages = self._reader.messages(wanted)
        while True:
            with _explained(self.path):
                batch = [
                    Message(c.topic, time, bytes(data), time, channels[c.id])
                    for c, time, data in islice(messages, BATCH)
                ]
                if not batch:
                    break
                block = messages_of(batch).sorted()
            count += len(batch)
            yield block
        expected = sum(connection.msgcount for connection in wanted)
        if count != expected:
            self.notify(f"{self.path} holds {count} messages, its metadata declares {expected}")


def _topic(connection: Connection) -> Topic:
    extension = connection.ext
    assert isinstance(extension, ConnectionExtRosbag2)
    return Topic(
        name=connection.topic,
        type_name=connection.msgtype,
        count=connection.msgcount,
        definition=connection.msgdef.data,
        definition_format=_FORMATS[connection.msgdef.format],
        encoding=extension.serialization_format,
        metadata=(
            ("offered_qos_profiles", dump_yaml(dump_qos_v9(extension.offered_qos_profiles))),
            ("topic_type_hash", connection.digest),
        ),
    )
