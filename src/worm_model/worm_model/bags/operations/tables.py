# SPDX-License-Identifier: Apache-2.0
"""Topics of a bag as tables, one row per message and one column per field, read in batches."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from worm_model.bags.formats.bag_errors import BagError
from worm_model.bags.formats.cdr import ColumnBuilder, MessageColumns, types_of
from worm_model.bags.formats.message_block import Messages, Topic
from worm_model.bags.opening import Bag

LOG_TIME = "log_time_ns"
TEXT = "text"
SECONDS, NANOSECONDS = ".sec", ".nanosec"
MOST_ELEMENTS = 256  # a larger array, such as an image, is one column of lists

ColumnKind = str  # numpy's name of a number type, or TEXT
TableRows = Mapping[str, list[Any]]


@dataclass(frozen=True)
class TopicTable:
    """Columns of a topic in their order. A time is one column in ns; a short array has one column per element.

    Attributes:
        topic: topic whose messages are the rows; its count is the number of rows.
        channels: channels that can be decoded, including those of other topics.
        kinds: kind of the columns with one value per row, by name.
        lists: kind of the elements of the columns with an array of more than MOST_ELEMENTS per row, by name.
    """

    topic: Topic
    channels: frozenset[Topic]
    kinds: Mapping[str, ColumnKind]
    lists: Mapping[str, ColumnKind]


@dataclass
class _Field:
    """Values of a topic's field: `width` is None for one value, else the largest number of elements of an array."""

    kind: ColumnKind
    width: int | None
    values: list[Any]

    def joined(self, other: _Field) -> _Field:
        """Return an empty field with the kind and width that can represent both fields."""
        texts = TEXT in (self.kind, other.kind)
        kind = TEXT if texts else str(np.result_type(self.kind, other.kind))
        widths = [width for width in (self.width, other.width) if width is not None]
        return _Field(kind, max(widths, default=None), [])

    @property
    def is_list(self) -> bool:
        """True if the field is too wide for one column per element."""
        return (self.width or 0) > MOST_ELEMENTS

    def columns(self, path: str, width: int | None) -> Iterator[tuple[str, list[Any]]]:
        """Yield names and values of the columns: one column, or one for each of ``width`` elements of an array."""
        if width is None or width > MOST_ELEMENTS:
            yield path, self.values
            return
        for i in range(width):
            yield f"{path}[{i}]", [_element(value, i) for value in self.values]


def find_tables(bag: Bag, topics: Iterable[str]) -> tuple[list[TopicTable], dict[str, BagError]]:
    """Return the tables of the topics that can be decoded, and the errors of all that is left out by name.

    Of a topic with several types or encodings, those that can be decoded are in its table. Topics without messages have
    no table. The whole bag is read once, because the length of a sequence may change from message to message.
    """
    fields: dict[str, dict[str, _Field]] = {name: {} for name in topics}
    readable, failed = _readable(bag, fields)
    for block in bag.blocks(fields):
        for name, messages in block.by_topic():
            try:
                read = _fields(messages.within(readable)) if name not in failed else {}
            except BagError as error:
                failed[name] = error
                continue
            for path, new in read.items():
                known = fields[name].get(path)
                fields[name][path] = new.joined(known or new)
    counts: Counter[str] = Counter()
    for channel in readable:
        counts[channel.name] += channel.count
    tables = [
        _table(replace(bag.topics[name], count=counts[name]), readable, fields[name])
        for name in fields
        if name not in failed
    ]
    return [table for table in tables if table.kinds], failed


def _readable(bag: Bag, topics: Collection[str]) -> tuple[frozenset[Topic], dict[str, BagError]]:
    """Return the channels of some topics that can be decoded, and the errors of the others by their names."""
    channels = [channel for channel in bag.channels if channel.name in topics and channel.count]
    readable, failed = set(), {}
    for channel in channels:
        try:
            types_of(channel)
            readable.add(channel)
        except BagError as error:
            failed[channel] = error
    whole = {channel.name for channel in readable}
    return frozenset(readable), {
        f"{c.name} ({c.count} messages of {c.type_name} in {c.encoding})"
        if c.name in whole
        else c.name: error
        for c, error in failed.items()
    }


def _table(topic: Topic, channels: frozenset[Topic], fields: Mapping[str, _Field]) -> TopicTable:
    kinds = {
        column: known.kind
        for path, known in fields.items()
        if not known.is_list
        for column, _ in known.columns(path, known.width)
    }
    lists = {path: known.kind for path, known in fields.items() if known.is_list}
    return TopicTable(topic, channels, kinds, lists)


def read_tables(bag: Bag, tables: Iterable[TopicTable]) -> Iterator[tuple[TopicTable, TableRows]]:
    """Yield (table, rows) in batches. Rows are a list of values for each column; None if a message lacks the field."""
    by_topic = {table.topic.name: table for table in tables}
    for block in bag.blocks(by_topic):
        for name, messages in block.by_topic():
            table = by_topic[name]
            columns_read: dict[str, list[Any]] = {}
            messages = messages.within(table.channels)
            for path, here in _fields(messages).items():
                width = MOST_ELEMENTS + 1 if path in table.lists else here.width
                columns_read.update(here.columns(path, width))
            missing = [None] * len(messages)
            yield table, {n: columns_read.get(n, missing) for n in (*table.kinds, *table.lists)}


def _fields(messages: Messages) -> dict[str, _Field]:
    """Return kind, width and values of the fields of messages."""
    builder = ColumnBuilder()
    builder.add(messages)
    columns = builder.columns()
    fields_read = {LOG_TIME: _Field("int64", None, messages.log_time.tolist())}
    for path, values in columns.numbers.items():
        stem = path.removesuffix(SECONDS).removesuffix(NANOSECONDS)
        if stem + SECONDS in columns.numbers and stem + NANOSECONDS in columns.numbers:
            fields_read[f"{stem}_ns"] = _Field("int64", None, _nanoseconds(columns, stem))
        else:
            fields_read[path] = _number_field(values)
    for path, texts in columns.texts.items():
        fields_read[path] = _Field(TEXT, None, list(texts))
    return fields_read


def _nanoseconds(columns: MessageColumns, stem: str) -> list[Any]:
    """Return times in ns as Python integers, because they would overflow the number type of the seconds."""
    seconds, rest = columns.numbers[stem + SECONDS], columns.numbers[stem + NANOSECONDS]
    pairs = zip(seconds.tolist(), rest.tolist(), strict=True)
    return [
        None if whole is None or part is None else int(whole) * 10**9 + int(part)
        for whole, part in pairs
    ]


def _number_field(values: np.ndarray[Any, Any]) -> _Field:
    if values.dtype != object:
        width = None if values.ndim == 1 else values.shape[1]
        return _Field(str(values.dtype), width, values.tolist() if width is None else list(values))
    present = [value for value in values if value is not None]
    kind = str(np.result_type(*(np.asarray(value) for value in present))) if present else "float64"
    arrays = [np.size(value) for value in present if np.ndim(value)]
    return _Field(kind, max(arrays, default=None), list(values))


def _element(value: Any, index: int) -> Any:
    """Return an element of a message's field, or None if the field has no such element."""
    if value is None or np.size(value) <= index:
        return None
    return np.ravel(value)[index].item()
