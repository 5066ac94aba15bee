# SPDX-License-Identifier: Apache-2.0
"""Table of the recorded runs: one row for each run of each bag below a folder, with an index of bags already read."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from worm_model.bags.formats.finding import bags_below, mark_of, name_below
from worm_model.commands import bag_columns
from worm_model.commands.bag_columns import DAMAGED, MISSING, STATE, UNREADABLE
from worm_model.commands.bag_runs import rows_of_bag
from worm_model.errors import InputError
from worm_model.text_table import text_table

Row = dict[str, Any]

METRICS_VERSION = 6  # Increase this number when the computation of a metric changes.


def bag_rows(
    folder: Path, parameters: str, progress: Callable[[float], None]
) -> tuple[list[Row], int]:
    """Return the rows of all runs, and the number of bags that were read because the index lacked their present state.

    ``folder`` is a folder with bags, or a single bag. ``parameters`` is the path of a parameter file; empty: the file
    in each bag, else the paper's values. Raises `InputError` if there is no bag.
    """
    bags = bags_below(folder)
    index = _index_file(folder, parameters)
    known = _known(index)
    # The keys are relative paths, because the index is the same however the path of the folder is given.
    keys = {bag: str(bag.relative_to(folder)) for bag in bags}
    marks = {bag: mark_of(bag) for bag in bags}
    todo = [bag for bag in bags if known.get(keys[bag], [""])[0] != marks[bag]]
    for done, bag in enumerate(todo, 1):
        known[keys[bag]] = [marks[bag], _read(bag.absolute(), parameters)]
        progress(done / len(todo))
    if todo or len(known) != len(bags):
        _store(index, {key: known[key] for key in keys.values()})
    rows = [{"bag": str(bag), **row} for bag in bags for row in known[keys[bag]][1]]
    return rows, len(todo)


def _index_file(folder: Path, parameters: str) -> Path:
    content = Path(parameters).read_bytes() if parameters else b""
    keys = [column.key for column in bag_columns.COLUMNS]
    name = f"{METRICS_VERSION} {keys}\n".encode() + os.fsencode(folder.resolve()) + b"\n" + content
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser())
    return home / "worm_model" / f"bags-{hashlib.sha256(name).hexdigest()[:16]}.json"


def _known(index: Path) -> dict[str, Any]:
    """Return the content of an index; empty if the file is missing or invalid."""
    try:
        content = json.loads(index.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}


def _store(index: Path, content: dict[str, Any]) -> None:
    """Write the index without the unreadable bags. The next call reads them again, and all bags if writing fails."""
    content = {key: entry for key, entry in content.items() if entry[1][0][STATE] != UNREADABLE}
    with suppress(OSError):
        index.parent.mkdir(parents=True, exist_ok=True)
        part = index.with_name(f"{index.name}.{os.getpid()}")
        part.write_text(json.dumps(content), encoding="utf-8")
        part.replace(index)


def _read(bag: Path, parameters: str) -> list[Row]:
    """Return the rows of a bag, or one row with the reason why it has none. The bag is not changed."""
    empty: Row = {column.key: None for column in bag_columns.COLUMNS}
    try:
        rows = rows_of_bag(bag, parameters)
    except OSError as error:
        rows = [{STATE: UNREADABLE, "notes": str(error)}]
    except InputError as error:
        rows = [{STATE: DAMAGED, "notes": str(error)}]
    return [{**empty, **row, "notes": " ".join(row["notes"].split())} for row in rows]


def _without_empty(lines: Sequence[Sequence[str]]) -> list[list[str]]:
    """Return a table without empty columns, such as the conditions on level ground."""
    columns = zip(*lines, strict=True)
    filled = [column for column in columns if set(column[1:]) - {"", MISSING}]
    return [list(row) for row in zip(*filled, strict=True)]


def describe(rows: Sequence[Row], folder: Path) -> str:
    """Return the table as text."""
    shown = [column for column in bag_columns.COLUMNS if column.title]
    lines = [["bag", *(column.title for column in shown)]]
    notes = []
    for row in rows:
        name = name_below(folder, Path(row["bag"]))
        values = {**row, "health": row["health"] or row[STATE]}
        cells = (MISSING if values[c.key] is None else c.text(values[c.key]) for c in shown)
        lines.append([name, *cells])
        if row["notes"]:
            notes.append(f"{name}: {row['notes']}")
    lines = _without_empty(lines)
    return "\n".join([text_table(lines), *dict.fromkeys(notes)])
