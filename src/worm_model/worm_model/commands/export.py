# SPDX-License-Identifier: Apache-2.0
"""Command line: export of a bag's topics as CSV or Parquet tables."""

from __future__ import annotations

import argparse
import csv
import math
from collections.abc import Iterable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from worm_model.bags.formats.bag_errors import BagError
from worm_model.bags.formats.bag_writer import new_folder
from worm_model.bags.opening import Bag, open_bag
from worm_model.bags.operations.tables import (
    MOST_ELEMENTS,
    TEXT,
    ColumnKind,
    TableRows,
    find_tables,
    read_tables,
)
from worm_model.bags.run_reader import RUN_TOPICS, read_run
from worm_model.bags.worm_topics import TYPES
from worm_model.commands import command_line

STEM_BYTES = 200  # bytes, longest file name without its ending
MERGED = "run"  # name of the table with all measurements and commands
_NOTIFY = command_line.notifier("export")

Kinds = Mapping[str, ColumnKind]
_RUN_TYPES = {TYPES[name] for name in RUN_TOPICS if name != "joint_states"}


class CsvWriter:
    """Writer of a CSV file with the columns ``kinds``.

    The columns ``lists`` contain arrays. They are not written, because a CSV cell contains one value.
    Numbers are written without loss of precision. Missing values and NaN are empty cells.
    """

    def __init__(self, path: Path, kinds: Kinds, lists: Kinds) -> None:
        self._columns = list(kinds)
        self._stream = path.open("x", encoding="utf-8", newline="")
        self._writer = csv.writer(self._stream, lineterminator="\n")
        self._writer.writerow(self._columns)
        for name in lists:
            _NOTIFY(
                f"{path.name}: {name} is not exported, because its arrays have more than {MOST_ELEMENTS} elements; "
                "use --format parquet"
            )

    def write(self, rows: TableRows) -> None:
        """Append rows."""
        columns = (map(_cell, rows[name]) for name in self._columns)
        self._writer.writerows(zip(*columns, strict=True))

    def close(self) -> None:
        """Finish the file."""
        self._stream.close()


def _cell(value: Any) -> Any:
    return "" if value is None or (isinstance(value, float) and math.isnan(value)) else value


class ParquetWriter:
    """Writer of a Parquet file with the columns ``kinds`` and ``lists``.

    Columns have the types of the fields. Missing values are null, and NaN remains NaN.
    """

    def __init__(self, path: Path, kinds: Kinds, lists: Kinds) -> None:
        try:
            import pyarrow as arrow
            from pyarrow import parquet
        except ImportError:
            raise command_line.InputError(
                "Parquet requires pyarrow: pip install pyarrow, or use --format csv"
            ) from None
        types = {
            name: arrow.string() if kind == TEXT else arrow.from_numpy_dtype(kind)
            for name, kind in kinds.items()
        }
        for name, kind in lists.items():
            types[name] = arrow.list_(arrow.from_numpy_dtype(kind))
        self._arrow = arrow
        self._schema = arrow.schema(list(types.items()))
        self._writer = parquet.ParquetWriter(path, self._schema)

    def write(self, rows: TableRows) -> None:
        """Append rows."""
        self._writer.write_table(self._arrow.table(dict(rows), schema=self._schema))

    def close(self) -> None:
        """Finish the file."""
        self._writer.close()


TableWriter = CsvWriter | ParquetWriter
WRITERS: Mapping[str, type[TableWriter]] = {"csv": CsvWriter, "parquet": ParquetWriter}


@dataclass(frozen=True)
class Exported:
    """Result of an export: the number of `rows` by file name, and the reason for each topic that is `left_out`."""

    rows: dict[str, int] = field(default_factory=dict)
    left_out: dict[str, str] = field(default_factory=dict)


def export(bag: Bag, output: Path, kind: str, topics: list[str], namespace: str = "") -> Exported:
    """Write one table per topic to a new folder and, if ``topics`` is empty, the merged table of the robot.

    ``namespace`` is that of the robot; empty: the only one in the bag. Only the merged table is held in memory as a
    whole. If the export fails, no folder remains.
    """
    tables, failed = find_tables(bag, topics or bag.topics)
    stems = file_stems(table.topic.name for table in tables)
    exported = Exported(left_out={name: str(reason) for name, reason in failed.items()})
    with new_folder(output) as folder, ExitStack() as stack:
        writers: dict[str, TableWriter] = {}
        for table in tables:
            file = f"{stems[table.topic.name]}.{kind}"
            writer = WRITERS[kind](folder / file, table.kinds, table.lists)
            stack.callback(writer.close)
            writers[table.topic.name] = writer
            exported.rows[file] = table.topic.count
        for table, batch in read_tables(bag, tables):
            writers[table.topic.name].write(batch)
        if not topics and any(channel.type_name in _RUN_TYPES for channel in bag.channels):
            _export_merged(bag, folder / f"{MERGED}.{kind}", namespace, exported)
    return exported


def _export_merged(bag: Bag, path: Path, namespace: str, exported: Exported) -> None:
    """Write the merged table, or add the reason why it cannot be written to ``exported.left_out``."""
    try:
        from worm_model.analysis.run_table import run_table  # here: SciPy and Numba load slowly

        columns = run_table(read_run(bag, namespace)).columns
    except BagError as error:
        exported.left_out[MERGED] = str(error)
        return
    kinds = {
        name: TEXT if column.dtype == object else str(column.dtype)
        for name, column in columns.items()
    }
    writer = WRITERS[path.suffix[1:]](path, kinds, {})
    writer.write({name: column.tolist() for name, column in columns.items()})
    writer.close()
    exported.rows[path.name] = len(columns["stamp_ns"])


def file_stems(topics: Iterable[str]) -> dict[str, str]:
    """Return a unique file name, without ending, for each topic: a__b for /a/b, and a__b_2 for a later /a__b."""
    stems: dict[str, str] = {}
    for topic in topics:
        stem = wanted = _file_stem(topic)
        number = 1
        while stem.lower() in {MERGED, *(used.lower() for used in stems.values())}:
            number += 1
            stem = f"{wanted}_{number}"
        stems[topic] = stem
    return stems


def _file_stem(topic: str) -> str:
    """Return a topic's name as a file name. Bags may contain any name; file systems allow at most 255 bytes."""
    plain = "".join(c if c.isprintable() else "_" for c in topic.strip("/").replace("/", "__"))
    return plain.encode(errors="replace")[:STEM_BYTES].decode(errors="ignore") or "_"


def _parser() -> command_line.Parser:
    parser = command_line.Parser(
        prog="export",
        description="Write a table for each topic of a bag (a row per message, a column per field, times in ns), and "
        f"{MERGED}.csv or {MERGED}.parquet with all measurements and commands, in seconds since the gait's onset. "
        "The exit status is 1 if a topic is left out.",
    )
    parser.add_argument("bag", type=Path, metavar="BAG")
    parser.add_argument("--output", required=True, metavar="FOLDER", help="must not exist")
    parser.add_argument("--format", choices=WRITERS, default="csv", help="default csv")
    parser.add_argument(
        "--topic", action="append", default=[], help="export only this topic; may be repeated"
    )
    parser.add_argument(
        "--namespace",
        default="",
        help="namespace of the merged table's robot; default: the only one in the bag",
    )
    parser.add_definitions()
    parser.add_json()
    return parser


def _export(options: argparse.Namespace) -> int:
    output = command_line.new_file(options.output)
    with open_bag(options.bag, _NOTIFY, options.definitions) as bag:
        exported = export(bag, output, options.format, options.topic, options.namespace)
    for name, reason in exported.left_out.items():
        _NOTIFY(f"{name} is left out: {reason}")
    text = "\n".join(f"{output / name}: {count} rows" for name, count in exported.rows.items())
    content = {"output": str(output), "rows": exported.rows, "left_out": exported.left_out}
    command_line.print_result(options, content, text)
    return command_line.FAILED if exported.left_out else command_line.DONE


main = command_line.executable(_parser, _export)
