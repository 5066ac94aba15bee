# SPDX-License-Identifier: Apache-2.0
"""Files of rosbag2's sqlite3 storage, read by `rosbags`."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import cast

import apsw
import numpy as np
from rosbags.interfaces import Connection, ConnectionExtRosbag2, MessageDefinitionFormat
from rosbags.rosbag2 import ReaderError
from rosbags.rosbag2.metadata import dump_qos_v9
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader

from worm_model.bags.formats.bag_errors import BagError
from worm_model.bags.formats.bag_metadata import dump_yaml
from worm_model.bags.formats.finding import check_readable
from worm_model.bags.formats.message_block import Message, Messages, Topic, messages_of
from worm_model.bags.formats.stored_file import Extent, StoredFile, spans_of

TOGETHER = 1000  # number of messages of an extent
_JOURNALS = ("-wal", "-journal")  # endings of files with messages of an unclosed database
_FORMATS = {MessageDefinitionFormat.MSG: "ros2msg", MessageDefinitionFormat.IDL: "ros2idl"}


class SqliteFile(StoredFile):
    """Sqlite3 file. Opening it reads the log times of all messages.

    Raises BagError if the file is not an SQLite file, or is damaged.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        check_readable(path)
        self._reader = Sqlite3Reader(path)
        with self._explained():
            self._reader.open()
            query = "SELECT timestamp FROM messages ORDER BY timestamp"
            times = np.array([row[0] for row in self._reader.dbconn.execute(query)], np.uint64)
        self.channels = {c.id: _topic(c) for c in self._reader.connections}
        self.spans = spans_of(times)
        # ranges of log time with about TOGETHER messages each
        edges = np.unique(times[::TOGETHER]).tolist()
        if edges:
            edges.append(int(times[-1]) + 1)
        self.extents = [Extent(first, last - 1, first, last) for first, last in pairwise(edges)]
        journals = [Path(f"{path}{ending}") for ending in _JOURNALS]
        if left := [file.name for file in journals if file.is_file() and file.stat().st_size]:
            self.damage = (
                f"it was not closed; the messages in {left[0]} are not read. To add them: "
                f"sqlite3 {path.name} 'PRAGMA wal_checkpoint'"
            )

    @contextmanager
    def _explained(self) -> Iterator[None]:
        """Convert the exceptions of the database to a BagError."""
        try:
            yield
        except (apsw.Error, ReaderError, ValueError, TypeError, OverflowError) as error:
            reason = " ".join(str(error).split()) or type(error).__name__
            raise BagError(
                f"{self.path} is damaged, or not an SQLite bag ({reason}); the command .recover of sqlite3 may save it"
            ) from None

    def messages(self, extent: Extent, topics: frozenset[str]) -> Messages:
        """Return the messages of some topics in an extent.

        The publish time of a message is unknown and is set to the log time.
        """
        wanted = [c for c in self._reader.connections if c.topic in topics]
        with self._explained():
            rows = list(self._reader.messages(wanted, extent.first, extent.last))
        return messages_of(
            [Message(c.topic, time, data, time, self.channels[c.id]) for c, time, data in rows]
        )

    def close(self) -> None:
        """Close the file."""
        self._reader.close()


def _topic(connection: Connection) -> Topic:
    extension = cast(ConnectionExtRosbag2, connection.ext)
    profiles = extension.offered_qos_profiles
    metadata = (
        ("offered_qos_profiles", dump_yaml(dump_qos_v9(profiles)) if profiles else ""),
        ("topic_type_hash", connection.digest),
    )
    definition = connection.msgdef
    return Topic(
        connection.topic,
        connection.msgtype,
        connection.msgcount,
        definition.data,
        _FORMATS.get(definition.format, ""),
        extension.serialization_format,
        metadata,
    )
