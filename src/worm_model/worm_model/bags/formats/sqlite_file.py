# SPDX-License-Identifier: Apache-2.0
"""Files of rosbag2's sqlite3 storage, read by `rosbags`."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
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
from worm_model.bags.formats.message_block import Message, Messages, Topic, messages_of
from worm_model.bags.formats.stored_file import Extent, StoredFile, opened, spans_of

TOGETHER = 1000  # number of messages of an extent
_JOURNALS = ("-wal", "-journal")  # endings of files with messages of an unclosed database
_FORMATS = {MessageDefinitionFormat.MSG: "ros2msg", MessageDefinitionFormat.IDL: "ros2idl"}


class SqliteFile(StoredFile):
    """Sqlite3 file. Opening it reads the log times of all messages.

    Raises BagError if the file is not an SQLite file, or is damaged.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._stream = opened(path)
        self._reader = Sqlite3Reader(Path(self._stream.name))
        with self._explained():
            self._reader.open()
            query = "SELECT timestamp FROM messages ORDER BY timestamp"
            times = np.array([row[0] for row in self._reader.dbconn.execute(query)], np.uint64)
        self.channels = {c.id: _topic(c) for c in self._reader.connections}
        self.counts.update({c.id: c.msgcount for c in self._reader.connections})
        self.spans = spans_of(times)
        for first, last in _ranges(times):
            self.extents.append(Extent(first, last - 1, first, last))
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

    def blocks(
        self, extents: Iterable[Extent], topics: frozenset[str]
    ) -> Iterator[tuple[int, Messages]]:
        """Yield (start in ns, block) for the messages of some topics in some extents.

        The publish time of a message is unknown and is set to the log time.
        """
        wanted = [c for c in self._reader.connections if c.topic in topics]
        for extent in extents:
            with self._explained():
                block = messages_of(
                    [
                        Message(connection.topic, time, data, time, self.channels[connection.id])
                        for connection, time, data in self._reader.messages(
                            wanted, extent.first, extent.last
                        )
                    ]
                )
            if len(block):
                yield extent.start, block

    def close(self) -> None:
        """Close the file."""
        self._reader.close()
        self._stream.close()


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
        0,
        definition.data,
        _FORMATS.get(definition.format, ""),
        extension.serialization_format,
        metadata,
    )


def _ranges(times: np.ndarray) -> Iterator[tuple[int, int]]:
    """Yield ranges of log time (ns, the last one exclusive) with about TOGETHER messages each."""
    edges = np.unique(times[::TOGETHER]).tolist()
    if edges:
        yield from zip(edges, [*edges[1:], int(times[-1]) + 1], strict=True)
