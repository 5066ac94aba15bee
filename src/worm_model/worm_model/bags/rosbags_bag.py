# SPDX-License-Identifier: Apache-2.0
"""A bag in a format that only `rosbags` reads here: sqlite3, and rosbag2's compressed files or messages."""

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
from worm_model.bags.bag_metadata import dump_yaml
from worm_model.bags.message_block import Message, Messages, Topic, messages_of

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
    """Turn whatever the library raises at foreign content into a BagError: it asserts, too."""
    try:
        yield
    except Exception as error:  # noqa: BLE001
        reason = " ".join(str(error).split()) or type(error).__name__
        raise BagError(f"{path} cannot be read: {reason}") from None


class RosbagsBag(Bag):
    """Reads through `rosbags`, which offers neither metadata records nor attachments.

    Args:
        path: rosbag2 directory or sqlite3 file.
        notify: as `Bag` has it.

    Raises:
        BagError: it cannot be read.
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
        """None."""
        return iter(())

    def _blocks(self, topics: frozenset[str]) -> Iterator[Messages]:
        """Messages of some topics by rising log time; the sending time is not known and taken for the same."""
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
            raise BagError(f"{self.path} holds {count} messages instead of {expected}")


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
