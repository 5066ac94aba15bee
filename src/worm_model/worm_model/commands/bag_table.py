# SPDX-License-Identifier: Apache-2.0
"""Table of the recorded runs: one row for each run of each bag below a folder, with an index of bags already read."""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from worm_model.bags.finding import bags_below, mark_of, name_below
from worm_model.conditions import LEVEL, Conditions
from worm_model.errors import InputError
from worm_model.gait import named_values
from worm_model.text_table import text_table

Row = dict[str, Any]

CLOSED, OPEN, DAMAGED = "closed", "not closed", "damaged"
MISSING = "–"
METRICS_VERSION = 5  # Increase it when the computation of a metric changes.


@dataclass(frozen=True)
class Column:
    """Column of the table. To add a column, add a row to COLUMNS.

    Attributes:
        key: key of the value in a row and in `--json`.
        title: title in the printed table; empty: the column is not printed.
        value: returns the value from the `bag_runs.RunMetrics` of a run.
        text: returns the printed text of a value that is not None.
    """

    key: str
    title: str
    value: Callable[[Any], Any]
    text: Callable[[Any], str] = str


def _number(scale: float, decimals: int) -> Callable[[float], str]:
    return lambda value: MISSING if math.isnan(value) else f"{scale * value:.{decimals}f}"


def gait_text(gait: Mapping[str, Any] | None) -> str:
    """Return the gait of a row as text; empty without a gait."""
    if gait is None:
        return ""
    way = "" if gait["direction"] > 0 else " reverse"
    return f"{1e3 * gait['stroke']:.1f} mm {gait['frequency']:.3f} Hz{way}"


def local_time(start: str) -> str:
    """Return the ``start`` of a row (ISO 8601) in local time to the second, like the names of bags."""
    return datetime.fromisoformat(start).astimezone().strftime("%Y-%m-%d %H:%M:%S")


COLUMNS = (
    Column("start", "start", lambda run: run.start, local_time),
    Column("duration_s", "s", lambda run: run.duration_s, _number(1.0, 1)),
    Column("gait", "gait", lambda run: named_values(run.played.gait), gait_text),
    Column(
        "conditions",
        "conditions",
        lambda run: asdict(run.conditions),
        lambda values: "" if (stated := Conditions(**values)) == LEVEL else str(stated),
    ),
    Column("cycles", "cycles", lambda run: run.cycles, _number(1.0, 0)),
    Column("groove_phase", "φ mm", lambda run: run.groove_phase, _number(1e3, 2)),
    Column("grooves_per_cycle", "grooves", lambda run: run.grooves_per_cycle, _number(1.0, 2)),
    Column("speed", "mm/s", lambda run: run.speed, _number(1e3, 2)),
    Column("power", "W", lambda run: run.power, _number(1.0, 2)),
    Column("cost_of_transport", "COT", lambda run: run.cost_of_transport, _number(1.0, 1)),
    Column("health", "health", lambda run: run.report.health.name.lower()),
    Column("notes", "", lambda run: run.notes),
)
STATE = "state"  # key of the state of the files, which belongs to a bag, not to a run


def bag_rows(
    folder: Path, parameters: str, progress: Callable[[float], None]
) -> tuple[list[Row], int]:
    """Return (the rows of all runs below a folder, or of one bag; the number of bags that were not in the index).

    A recovered copy is listed instead of the bag itself. ``parameters`` is a parameter file; empty: the one in each
    bag, else the paper's values. Raises `InputError` if there is no bag.
    """
    bags = sorted(copies[-1] if copies else bag for bag, copies in bags_below(folder).items())
    index = _index_file(folder, parameters)
    known = _known(index)
    marks = {str(bag): mark_of(bag) for bag in bags}
    todo = [bag for bag in bags if known.get(str(bag), [""])[0] != marks[str(bag)]]
    for done, bag in enumerate(todo, 1):
        known[str(bag)] = [marks[str(bag)], _read(bag, parameters)]
        progress(done / len(todo))
    if todo or len(known) != len(bags):
        _store(index, {name: known[name] for name in marks})
    rows = [{"bag": str(bag), **row} for bag in bags for row in known[str(bag)][1]]
    return rows, len(todo)


def _index_file(folder: Path, parameters: str) -> Path:
    content = Path(parameters).read_bytes() if parameters else b""
    keys = [column.key for column in COLUMNS]
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
    """Write the index. A failure is ignored, because the next call reads the bags again."""
    with suppress(OSError):
        index.parent.mkdir(parents=True, exist_ok=True)
        part = index.with_name(f"{index.name}.{os.getpid()}")
        part.write_text(json.dumps(content), encoding="utf-8")
        part.replace(index)


def _read(bag: Path, parameters: str) -> list[Row]:
    """Return the rows of a bag, or one row with the reason why it cannot be read. The bag is not changed."""
    from worm_model.bags.recording.run_manifest import ManifestError
    from worm_model.commands.bag_runs import rows_of_bag, state_of_bag

    empty: Row = {column.key: None for column in COLUMNS}
    try:
        state, reason = state_of_bag(bag)
        if state != CLOSED:
            return [{**empty, STATE: state, "notes": reason}]
        return [{**empty, STATE: CLOSED, **row} for row in rows_of_bag(bag, parameters)]
    except (InputError, OSError) as error:
        state = CLOSED if isinstance(error, ManifestError) else DAMAGED
        return [{**empty, STATE: state, "notes": " ".join(str(error).split())}]


def _without_empty(lines: Sequence[Sequence[str]]) -> list[list[str]]:
    """Return a table without empty columns, such as the conditions on level ground."""
    columns = zip(*lines, strict=True)
    filled = [column for column in columns if set(column[1:]) - {"", MISSING}]
    return [list(row) for row in zip(*filled, strict=True)]


def describe(rows: Sequence[Row], folder: Path) -> str:
    """Return the table as text."""
    shown = [column for column in COLUMNS if column.title]
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
