# SPDX-License-Identifier: Apache-2.0
"""Topics of a bag as tables: a row a message, a column a field, read a batch at a time."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from worm_model.bags.bag import Bag, Topic
from worm_model.bags.bag_errors import BagError
from worm_model.bags.cdr import Columns
from worm_model.bags.payloads import Payloads
from worm_model.bags.run_reader import decode_topic

LOG_TIME = "log_time_ns"
TEXT = "text"
SECONDS, NANOSECONDS = ".sec", ".nanosec"

Kind = str  # numpy's name of a number's type, or TEXT
Rows = Mapping[str, list[Any]]


@dataclass(frozen=True)
class Table:
    """Columns of a topic: kind by name, in their order. Times are one column in ns, arrays one column an element."""

    topic: Topic
    kinds: Mapping[str, Kind]


def find_tables(bag: Bag, topics: Iterable[str]) -> tuple[list[Table], dict[str, BagError]]:
    """The tables of some topics, and why others have none. Reads the bag once: sequences may grow within it."""
    kinds: dict[str, dict[str, Kind]] = {name: {} for name in topics}
    failed: dict[str, BagError] = {}
    for block in bag.blocks(kinds):
        for name, messages in block.by_topic():
            if name in failed:
                continue
            try:
                columns = _flat(bag.topics[name], messages)
            except BagError as error:
                failed[name] = error
                continue
            for path, (kind, _) in columns.items():
                kinds[name].setdefault(path, kind)
    tables = [
        Table(bag.topics[name], kinds[name]) for name in kinds if kinds[name] and name not in failed
    ]
    return tables, failed


def read_tables(bag: Bag, tables: Iterable[Table]) -> Iterator[tuple[Table, Rows]]:
    """Rows of tables, a batch at a time: lists by column name, None where a message lacks the field."""
    by_topic = {table.topic.name: table for table in tables}
    for block in bag.blocks(by_topic):
        for name, messages in block.by_topic():
            table = by_topic[name]
            found = _flat(table.topic, messages)
            missing = [None] * len(messages)
            yield (
                table,
                {path: found[path][1] if path in found else missing for path in table.kinds},
            )


def _flat(topic: Topic, messages: Payloads) -> dict[str, tuple[Kind, list[Any]]]:
    """Kind and values of each column."""
    columns = decode_topic(topic, messages)
    flat: dict[str, tuple[Kind, list[Any]]] = {LOG_TIME: ("int64", messages.log_time.tolist())}
    for path, values in columns.numbers.items():
        if path.endswith(SECONDS) and path.removesuffix(SECONDS) + NANOSECONDS in columns.numbers:
            stem = path.removesuffix(SECONDS)
            flat[f"{stem}_ns"] = "int64", _nanoseconds(columns, stem)
        elif (
            not path.endswith(NANOSECONDS)
            or path.removesuffix(NANOSECONDS) + SECONDS not in columns.numbers
        ):
            flat.update(_number_columns(path, values))
    for path, texts in columns.texts.items():
        flat[path] = TEXT, list(texts)
    return flat


def _nanoseconds(columns: Columns, stem: str) -> list[Any]:
    seconds, rest = columns.numbers[stem + SECONDS], columns.numbers[stem + NANOSECONDS]
    pairs = zip(seconds.tolist(), rest.tolist(), strict=True)
    return [None if whole is None else whole * 10**9 + part for whole, part in pairs]


def _number_columns(
    path: str, values: np.ndarray[Any, Any]
) -> Iterator[tuple[str, tuple[Kind, list[Any]]]]:
    if values.dtype != object:
        elements = (
            [(path, values)]
            if values.ndim == 1
            else [(f"{path}[{i}]", values[:, i]) for i in range(values.shape[1])]
        )
        for name, column in elements:
            yield name, (str(column.dtype), column.tolist())
        return
    present = [value for value in values if value is not None]
    width = max((np.size(value) for value in present), default=0)
    kind = str(np.asarray(present[0]).dtype) if present else "float64"
    scalar = all(np.ndim(value) == 0 for value in present)
    for i in range(width):
        name = path if scalar else f"{path}[{i}]"
        yield name, (kind, [_element(value, i) for value in values])


def _element(value: Any, index: int) -> Any:
    """An element of a message's field, None where it has none."""
    if value is None or np.size(value) <= index:
        return None
    return np.ravel(value)[index].item()
