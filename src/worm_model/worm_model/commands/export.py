# SPDX-License-Identifier: Apache-2.0
"""Command line: a bag's topics as CSV or Parquet tables."""

from __future__ import annotations

import argparse
import csv
import math
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Protocol

from worm_model.bags.bag import Bag
from worm_model.bags.draft import new_folder
from worm_model.bags.opening import open_bag
from worm_model.bags.tables import TEXT, Rows, Table, find_tables, read_tables
from worm_model.commands.command_line import (
    InputError,
    Parser,
    new_file,
    notifier,
    print_result,
    run_command,
)

FORMATS = ("csv", "parquet")
_NOTIFY = notifier("export")


class TableWriter(Protocol):
    """Takes the rows of one table."""

    def write(self, rows: Rows) -> None:
        """Append rows."""
        ...

    def close(self) -> None:
        """Finish the file."""
        ...


class CsvWriter:
    """Numbers are written so that reading them gives the same; what is missing, and NaN, is an empty cell."""

    def __init__(self, path: Path, table: Table) -> None:
        self._stream = path.open("x", encoding="utf-8", newline="")
        self._writer = csv.writer(self._stream, lineterminator="\n")
        self._writer.writerow(table.kinds)

    def write(self, rows: Rows) -> None:
        """Append rows."""
        self._writer.writerows(zip(*(map(_cell, column) for column in rows.values()), strict=True))

    def close(self) -> None:
        """Finish the file."""
        self._stream.close()


def _cell(value: Any) -> Any:
    return "" if value is None or (isinstance(value, float) and math.isnan(value)) else value


class ParquetWriter:
    """Columns keep their types; what is missing is null, NaN stays NaN."""

    def __init__(self, path: Path, table: Table) -> None:
        try:
            import pyarrow as arrow
            from pyarrow import parquet
        except ImportError:
            raise InputError(
                "Parquet needs pyarrow: pip install pyarrow, or use --format csv"
            ) from None
        types = {
            name: arrow.string() if kind == TEXT else arrow.from_numpy_dtype(kind)
            for name, kind in table.kinds.items()
        }
        self._arrow = arrow
        self._schema = arrow.schema(list(types.items()))
        self._writer = parquet.ParquetWriter(path, self._schema)

    def write(self, rows: Rows) -> None:
        """Append rows."""
        self._writer.write_table(self._arrow.table(dict(rows), schema=self._schema))

    def close(self) -> None:
        """Finish the file."""
        self._writer.close()


WRITERS: Mapping[str, type[CsvWriter] | type[ParquetWriter]] = {
    "csv": CsvWriter,
    "parquet": ParquetWriter,
}


def export(bag: Bag, output: Path, kind: str, topics: list[str]) -> dict[str, int]:
    """Write a table a topic into a new folder; returns the number of rows by file name.

    Memory does not grow with the bag. The folder is there whole or not at all.

    Raises:
        BagError: the bag lacks a topic or is damaged.
        InputError: the format needs a package that is not installed.
    """
    tables, failed = find_tables(bag, topics or bag.topics)
    for name, reason in failed.items():
        _NOTIFY(f"{name} is left out: {reason}")
    rows: dict[str, int] = {}
    with new_folder(output) as draft, ExitStack() as stack:
        writers: dict[str, TableWriter] = {}
        for table in tables:
            file = f"{file_stem(table.topic.name)}.{kind}"
            writers[table.topic.name] = WRITERS[kind](draft / file, table)
            stack.callback(writers[table.topic.name].close)
            rows[file] = table.topic.count
        for table, batch in read_tables(bag, tables):
            writers[table.topic.name].write(batch)
    return rows


def file_stem(topic: str) -> str:
    """A file name for a topic; names of topics hold no double underscore, so no two topics share one."""
    return topic.strip("/").replace("/", "__")


def _parser() -> Parser:
    parser = Parser(
        prog="export",
        description="Writes a table for each topic of a bag: a row a message, a column a field; times in ns.",
    )
    parser.add_argument("bag", type=Path, metavar="BAG")
    parser.add_argument("--output", required=True, metavar="FOLDER", help="must not exist")
    parser.add_argument("--format", choices=FORMATS, default="csv", help="default csv")
    parser.add_argument(
        "--topic", action="append", default=[], help="only this one; may be repeated"
    )
    parser.add_json()
    return parser


def _export(options: argparse.Namespace) -> None:
    output = new_file(options.output)
    with open_bag(options.bag, _NOTIFY) as bag:
        rows = export(bag, output, options.format, options.topic)
    text = "\n".join(f"{output / name}: {count} rows" for name, count in rows.items())
    print_result(options, {"output": str(output), "rows": rows}, text)


def main() -> int:
    """Entry point of the executable export."""
    return run_command(_parser(), _export)
