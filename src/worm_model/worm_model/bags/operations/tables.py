# SPDX-License-Identifier: Apache-2.0
"""Topics of a bag as tables, one row per message and one column per field."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from typing import Any

import numpy as np

from worm_model.bags.formats.bag_errors import BagError
from worm_model.bags.formats.cdr import ColumnBuilder, MessageColumns, types_of
from worm_model.bags.formats.message_block import Topic
from worm_model.bags.opening import Bag

LOG_TIME = "log_time_ns"
SECONDS, NANOSECONDS = ".sec", ".nanosec"
MOST_ELEMENTS = 256  # longer arrays, such as images, are omitted

# an array or a list of values by name of the column; None in the rows of messages that lack the field
Table = Mapping[str, Any]


def read_tables(bag: Bag, topics: Collection[str]) -> tuple[dict[str, Table], dict[str, str]]:
    """Return the tables of some topics by name, and the reasons for all that is left out by name.

    A time is one column in ns. An array has one column per element. Of a topic with several types or encodings, those
    that can be decoded are in its table. Topics without messages have no table.
    """
    channels = [channel for channel in bag.channels if channel.name in topics and channel.count]
    readable, left_out = _readable(channels)
    builders = {channel.name: ColumnBuilder(MOST_ELEMENTS) for channel in readable}
    for block in bag.blocks(topics):
        for name, messages in block.by_topic():
            try:
                if name not in left_out:
                    builders[name].add(messages.within(readable))
            except BagError as error:
                left_out[name] = str(error)
    tables: dict[str, Table] = {}
    for name, builder in builders.items():
        if name not in left_out:
            tables[name] = dict(_columns(builder.columns()))
            for path in sorted(builder.omitted):
                bag.notify(
                    f"{name}: {path} is not exported, because its arrays have more than {MOST_ELEMENTS} elements"
                )
    return tables, left_out


def _readable(channels: Collection[Topic]) -> tuple[list[Topic], dict[str, str]]:
    """Return the channels that can be decoded, and the errors of the others by their names."""
    readable, errors = [], {}
    for channel in channels:
        try:
            types_of(channel)
            readable.append(channel)
        except BagError as error:
            errors[channel] = str(error)
    whole = {channel.name for channel in readable}
    return readable, {
        f"{c.name} ({c.count} messages of {c.type_name} in {c.encoding})"
        if c.name in whole
        else c.name: error
        for c, error in errors.items()
    }


def _columns(columns: MessageColumns) -> Iterator[tuple[str, Any]]:
    """Yield name and values of the columns of a table."""
    yield LOG_TIME, columns.log_time
    for path, values in columns.numbers.items():
        stem = path.removesuffix(SECONDS).removesuffix(NANOSECONDS)
        seconds, rest = (columns.numbers.get(stem + end) for end in (SECONDS, NANOSECONDS))
        if seconds is not None and rest is not None:
            if path.endswith(SECONDS):
                yield f"{stem}_ns", _nanoseconds(seconds, rest)
        elif values.dtype != object and values.ndim == 1:
            yield path, values
        else:
            yield from _elements(path, values)
    yield from columns.texts.items()


def _nanoseconds(seconds: Any, rest: Any) -> list[int | None]:
    """Return times in ns as Python integers, because they would overflow the number type of the seconds."""
    pairs = zip(seconds.tolist(), rest.tolist(), strict=True)
    return [
        None if whole is None or part is None else int(whole) * 10**9 + int(part)
        for whole, part in pairs
    ]


def _elements(path: str, values: Any) -> Iterator[tuple[str, Any]]:
    """Yield name and values of each element of an array, whose length may differ between messages."""
    if not any(np.ndim(value) for value in values):
        yield path, values.tolist()
        return
    if values.dtype != object:
        yield from ((f"{path}[{i}]", elements) for i, elements in enumerate(values.T))
        return
    for i in range(max(np.size(value) for value in values if value is not None)):
        elements = (
            value[i].item() if np.ndim(value) and len(value) > i else None for value in values
        )
        yield f"{path}[{i}]", list(elements)
