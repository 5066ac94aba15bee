# SPDX-License-Identifier: Apache-2.0
"""Command line: export of a bag's topics as CSV or Parquet tables."""

from __future__ import annotations

import argparse
import csv
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from worm_model.bags.formats.bag_errors import BagError
from worm_model.bags.formats.bag_writer import new_folder
from worm_model.bags.opening import Bag, open_bag
from worm_model.bags.operations.tables import Table, read_tables
from worm_model.bags.run_reader import RUN_TOPICS, read_run
from worm_model.bags.worm_topics import TYPES
from worm_model.commands import command_line

STEM_BYTES = 200  # bytes, longest file name without its ending
MERGED = "run"  # name of the table with all measurements and commands
_NOTIFY = command_line.notifier("export")

_RUN_TYPES = {TYPES[name] for name in RUN_TOPICS if name != "joint_states"}


def write_csv(path: Path, table: Table) -> None:
    """Write a CSV file. Numbers are written without loss of precision. Missing values and NaN are empty cells."""
    columns = (v.tolist() if isinstance(v, np.ndarray) else v for v in table.values())
    with path.open("x", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(table)
        writer.writerows(zip(*(map(_cell, column) for column in columns), strict=True))


def _cell(value: Any) -> Any:
    return "" if value is None or (isinstance(value, float) and math.isnan(value)) else value


def write_parquet(path: Path, table: Table) -> None:
    """Write a Parquet file. Columns have the types of the fields. Missing values are null, and NaN remains NaN."""
    try:
        import pyarrow as arrow
        from pyarrow import parquet
    except ImportError:
        raise command_line.InputError(
            "Parquet requires pyarrow: pip install pyarrow, or use --format csv"
        ) from None
    columns = {name: arrow.array(values) for name, values in table.items()}
    parquet.write_table(arrow.table(columns), path)


WRITERS: Mapping[str, Callable[[Path, Table], None]] = {"csv": write_csv, "parquet": write_parquet}


@dataclass(frozen=True)
class Exported:
    """Result of an export: the number of `rows` by file name, and the reason for each topic that is `left_out`."""

    rows: dict[str, int]
    left_out: dict[str, str]


def export(bag: Bag, output: Path, kind: str, topics: list[str], namespace: str = "") -> Exported:
    """Write one table per topic to a new folder and, if ``topics`` is empty, the merged table of the robot.

    ``namespace`` is that of the robot; empty: the only one in the bag. If the export fails, no folder remains.
    """
    found, left_out = read_tables(bag, topics or bag.topics)
    stems = file_stems(found)
    tables = {stems[name]: table for name, table in found.items()}
    if not topics and any(channel.type_name in _RUN_TYPES for channel in bag.channels):
        from worm_model.analysis.run_table import run_table  # here: SciPy and Numba load slowly

        try:
            tables[MERGED] = run_table(read_run(bag, namespace)).columns
        except BagError as error:
            left_out[MERGED] = str(error)
    rows = {}
    with new_folder(output) as folder:
        for stem, table in tables.items():
            WRITERS[kind](folder / f"{stem}.{kind}", table)
            rows[f"{stem}.{kind}"] = len(next(iter(table.values())))
    return Exported(rows, left_out)


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
    parser.add_json()
    return parser


def _export(options: argparse.Namespace) -> int:
    output = command_line.new_file(options.output)
    with open_bag(options.bag, _NOTIFY) as bag:
        exported = export(bag, output, options.format, options.topic, options.namespace)
    for name, reason in exported.left_out.items():
        _NOTIFY(f"{name} is left out: {reason}")
    text = "\n".join(f"{output / name}: {count} rows" for name, count in exported.rows.items())
    content = {"output": str(output), "rows": exported.rows, "left_out": exported.left_out}
    command_line.print_result(options, content, text)
    return command_line.FAILED if exported.left_out else command_line.DONE


main = command_line.executable(_parser, _export)
