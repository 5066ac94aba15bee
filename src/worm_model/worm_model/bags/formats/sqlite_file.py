# SPDX-License-Identifier: Apache-2.0
"""Files of rosbag2's sqlite3 storage, read row by row, so that a damaged page makes only its own rows unreadable."""

from __future__ import annotations

import shutil
import sqlite3
from collections.abc import Iterable, Iterator
from contextlib import suppress
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from worm_model.bags.formats.bag_errors import BagError
from worm_model.bags.formats.bag_metadata import named_qos
from worm_model.bags.formats.contents import Contents, Extent
from worm_model.bags.formats.message_block import Message, Messages, Topic, messages_of
from worm_model.bags.formats.stored_file import LATEST_NS, StoredFile, explained

MAGIC = b"SQLite format 3\0"
TOGETHER = 1000  # largest number of rows of an extent
_JOURNALS = ("-wal", "-journal")  # endings of files from which SQLite recovers an unclosed database
_PAGES = slice(28, 32)  # place of the number of pages in the head of a database

Row = tuple[Any, ...]


class SqliteFile(StoredFile):
    """Sqlite3 file. Opening it reads every readable row of the table ``messages`` once."""

    def _survey(self) -> Contents:
        if self.data[: len(MAGIC)] != MAGIC:
            raise BagError(
                f"{self.path} is not an SQLite file: it begins with {bytes(self.data[:8])!r}"
            )
        try:
            readable = self._columns("messages")
        except BagError:
            readable = set()
        if not readable:
            raise BagError(f"{self.path} has no table of messages that SQLite can read")
        complete = self._is_complete()
        contents = Contents(unit="rows", complete=complete, whole=complete)
        rows: list[Row] = []
        for row, first, last in self._rows("messages", "topic_id, timestamp, data"):
            if row is not None and self._is_message(row):
                contents.counts[row[1]] += 1
                rows.append(row[:3])  # without the payload
            else:
                contents.mark_lost(first, last)
                self._add_extent(contents, rows)
            if len(rows) >= TOGETHER:
                self._add_extent(contents, rows)
        self._add_extent(contents, rows)
        return contents

    def _is_complete(self) -> bool:
        page = int.from_bytes(self.data[16:18], "big")
        return len(self.data) >= int.from_bytes(self.data[_PAGES], "big") * (
            65536 if page == 1 else page
        )

    def _is_message(self, row: Row) -> bool:
        _, topic, time, payload = row
        return (
            topic in self.channels
            and isinstance(time, int)
            and 0 <= time <= LATEST_NS
            and isinstance(payload, bytes)
        )

    @staticmethod
    def _add_extent(contents: Contents, rows: list[Row]) -> None:
        if rows:
            times = [row[2] for row in rows]
            contents.extents.append(Extent(min(times), max(times), rows[0][0], rows[-1][0] + 1))
            rows.clear()

    @cached_property
    def _database(self) -> sqlite3.Connection:
        """Open database. If it was not closed, SQLite recovers a temporary copy of it."""
        journals = [Path(f"{self.path}{ending}") for ending in _JOURNALS]
        journals = [path for path in journals if path.is_file() and path.stat().st_size]
        if not journals:
            uri = f"{Path(self._stream.name).resolve().as_uri()}?mode=ro&immutable=1"
            database = sqlite3.connect(uri, uri=True, check_same_thread=False)
            # Without this setting, SQLite rejects a truncated file.
            database.execute("PRAGMA writable_schema = ON")
            return database
        self._copies = TemporaryDirectory()
        for path in (self.path, *journals):
            shutil.copy(path, self._copies.name)
        copy = Path(self._copies.name, self.path.name)
        return sqlite3.connect(copy, check_same_thread=False)

    def _rows(self, table: str, columns: str) -> Iterator[tuple[Row | None, int, int]]:
        """Yield (row, first id, last id) for each row of a table and for each range of unreadable rows.

        The last id is exclusive. The first value of a row is its id. For unreadable rows, the row is None.
        """
        query = f"SELECT id, {columns} FROM {table} WHERE id >= ? ORDER BY id"
        first: int | None = -(1 << 63)
        damaged = 0
        while first is not None:
            try:
                for row in self._database.execute(query, (first,)):
                    if row[0] < first:
                        raise sqlite3.DatabaseError("the ids of its rows do not increase")
                    if damaged:
                        yield None, damaged, row[0]
                        damaged = 0
                    yield row, row[0], row[0] + 1
                    first = row[0] + 1
                break
            except sqlite3.DatabaseError:
                damaged = damaged or max(first, 1)
                first = self._next_readable(query, max(first, 1))
        if damaged:
            yield None, damaged, damaged + 1

    def _next_readable(self, query: str, damaged: int) -> int | None:
        """Return the first id after a damaged one from which rows can be read, or None."""

        def is_readable(row: int) -> bool:
            try:
                return self._database.execute(f"{query} LIMIT 1", (row,)).fetchone() is not None
            except sqlite3.DatabaseError:
                return False

        low, step, most = damaged, 1, damaged + len(self.data)  # a row has at least one byte
        while not is_readable(low + step):
            low, step = low + step, 2 * step
            if low > most:
                return None
        high = low + step
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (low, middle) if is_readable(middle) else (middle, high)
        return high

    @cached_property
    def channels(self) -> dict[int, Topic]:
        """Topics by their number, without their counts."""
        definitions = {}
        if self._columns("message_definitions"):
            columns = "topic_type, encoding, encoded_message_definition"
            for row, _, _ in self._rows("message_definitions", columns):
                if row is not None:
                    definitions[row[1]] = row[2], row[3]
        known = self._columns("topics")
        optional = [
            c if c in known else "''" for c in ("offered_qos_profiles", "type_description_hash")
        ]
        topics = {}
        for row, _, _ in self._rows(
            "topics", f"name, type, serialization_format, {', '.join(optional)}"
        ):
            if row is not None and all(isinstance(text, str) for text in row[1:]):
                number, name, kind, encoding, qos, digest = row
                form, text = definitions.get(kind, ("", ""))
                metadata = (("offered_qos_profiles", named_qos(qos)), ("topic_type_hash", digest))
                topics[number] = Topic(name, kind, 0, text, form, encoding, metadata)
        return topics

    def _columns(self, table: str) -> set[str]:
        with explained(self.path):
            return {row[1] for row in self._database.execute(f"PRAGMA table_info({table})")}

    def blocks(
        self, extents: Iterable[Extent], topics: frozenset[str]
    ) -> Iterator[tuple[int, Messages]]:
        """Yield (start in ns, block) for the messages of some topics in some extents.

        The publish time of a message is unknown and is set to the log time.
        """
        query = "SELECT id, topic_id, timestamp, data FROM messages WHERE id >= ? AND id < ? ORDER BY id"
        channels = self.channels
        for extent in extents:
            with explained(self.path):
                rows = self._database.execute(query, (extent.first, extent.last)).fetchall()
                block = messages_of(
                    [
                        Message(channels[topic].name, time, bytes(data), time, channels[topic])
                        for _, topic, time, data in filter(self._is_message, rows)
                        if channels[topic].name in topics
                    ]
                )
            if len(block):
                yield extent.start, block

    def close(self) -> None:
        """Close the file, and remove the temporary copy if there is one."""
        with suppress(sqlite3.Error):
            self._database.close()
        if hasattr(self, "_copies"):
            self._copies.cleanup()
        super().close()
