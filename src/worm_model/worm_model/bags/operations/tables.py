# SPDX-License-Identifier: Apache-2.0
"""Topics of a bag as tables, one row per message and one column per field, read in batches."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from worm_model.bags.formats.bag_errors import BagError
from worm_model.bags.formats.cdr import ColumnBuilder, MessageColumns, types_of
from worm_model.bags.formats.message_block import Messages, Topic
from worm_model.bags.opening import Bag

LOG_TIME = "log_time_ns"
SECONDS, NANOSECONDS = ".sec", ".nanosec"
MOST_ELEMENTS = 256  # a larger array, such as an image, has no columns

TableRows = Mapping[str, list[Any]]


@dataclass(frozen=True)
class TopicTable:
    """Columns of a topic in their order. A time is one column in ns; an array has one column per element.

    Attributes:
        topic: topic whose messages are the rows; its count is the number of rows.
        channels: channels that can be decoded, including those of other topics.
        columns: names of the columns.
        omitted: paths of the fields with an array of more than MOST_ELEMENTS elements.
    """

    topic: Topic
    channels: frozenset[Topic]
    columns: Sequence[str]
    omitted: Sequence[str]


@dataclass
class _Field:
    """Values of a topic's field: `width` is None for one value, else the largest number of elements of an array."""

    width: int | None
    values: list[Any]

    def columns(self, path: str, width: int | None) -> Iterator[tuple[str, list[Any]]]:
        """Yield names and values of the columns: one column, or one for each of ``width`` elements of an array."""
        if width is None:
            yield path, self.values
            return
        for i in range(width):
            yield f"{path}[{i}]", [_element(value, i) for value in self.values]


def find_tables(bag: Bag, topics: Iterable[str]) -> tuple[list[TopicTable], dict[str, BagError]]:
    """Return the tables of the topics that can be decoded, and the errors of all that is left out by name.

    Of a topic with several types or encodings, those that can be decoded are in its table. Topics without messages have
    no table. The whole bag is read once, because the length of a sequence may change from message to message.
    """
    widths: dict[str, dict[str, int | None]] = {name: {} for name in topics}
    readable, failed = _readable(bag, widths)
    for block in bag.blocks(widths):
        for name, messages in block.by_topic():
            try:
                read = _fields(messages.within(readable)) if name not in failed else {}
            except BagError as error:
                failed[name] = error
                continue
            for path, new in read.items():
                known = widths[name].get(path)
                widths[name][path] = _larger(new.width, known)
    counts: Counter[str] = Counter()
    for channel in readable:
        counts[channel.name] += channel.count
    tables = [
        _table(replace(bag.topics[name], count=counts[name]), readable, widths[name])
        for name in widths
        if name not in failed
    ]
    return [table for table in tables if table.columns], failed


def _larger(one: int | None, other: int | None) -> int | None:
    return max((width for width in (one, other) if width is not None), default=None)


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


def _table(
    topic: Topic, channels: frozenset[Topic], widths: Mapping[str, int | None]
) -> TopicTable:
    omitted = [path for path, width in widths.items() if (width or 0) > MOST_ELEMENTS]
    columns = [
        column
        for path, width in widths.items()
        if path not in omitted
        for column, _ in _Field(None, []).columns(path, width)
    ]
    return TopicTable(topic, channels, columns, omitted)


def read_tables(bag: Bag, tables: Iterable[TopicTable]) -> Iterator[tuple[TopicTable, TableRows]]:
    """Yield (table, rows) in batches. Rows are a list of values for each column; None if a message lacks the field."""
    by_topic = {table.topic.name: table for table in tables}
    for block in bag.blocks(by_topic):
        for name, messages in block.by_topic():
            table = by_topic[name]
            columns_read: dict[str, list[Any]] = {}
            messages = messages.within(table.channels)
            for path, here in _fields(messages).items():
                if path not in table.omitted:
                    columns_read.update(here.columns(path, here.width))
            missing = [None] * len(messages)
            yield table, {name: columns_read.get(name, missing) for name in table.columns}


def _fields(messages: Messages) -> dict[str, _Field]:
    """Return width and values of the fields of messages."""
    builder = ColumnBuilder()
    builder.add(messages)
    columns = builder.columns()
    fields_read = {LOG_TIME: _Field(None, messages.log_time.tolist())}
    for path, values in columns.numbers.items():
        stem = path.removesuffix(SECONDS).removesuffix(NANOSECONDS)
        if stem + SECONDS in columns.numbers and stem + NANOSECONDS in columns.numbers:
            fields_read[f"{stem}_ns"] = _Field(None, _nanoseconds(columns, stem))
        else:
            fields_read[path] = _number_field(values)
    for path, texts in columns.texts.items():
        fields_read[path] = _Field(None, list(texts))
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
        return _Field(width, values.tolist() if width is None else list(values))
    arrays = [np.size(value) for value in values if value is not None and np.ndim(value)]
    return _Field(max(arrays, default=None), list(values))


def _element(value: Any, index: int) -> Any:
    """Return an element of a message's field, or None if the field has no such element."""
    if value is None or np.size(value) <= index:
        return None
    return np.ravel(value)[index].item()
