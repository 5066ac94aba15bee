# SPDX-License-Identifier: Apache-2.0
"""What was recorded: a row for each run of each bag below a folder, from an index of what was read before."""

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
FIGURES_VERSION = 5  # raise it where a figure is computed otherwise


@dataclass(frozen=True)
class Column:
    """A column of the table: all that a new one needs is a row of COLUMNS.

    Attributes:
        key: of the value in a row, and in `--json`.
        title: in the table for people; empty: it is not shown there.
        value: from the `bag_runs.RunFigures` of a run.
        text: of the value, which is not None.
    """

    key: str
    title: str
    value: Callable[[Any], Any]
    text: Callable[[Any], str] = str


def _number(scale: float, decimals: int) -> Callable[[float], str]:
    return lambda value: MISSING if math.isnan(value) else f"{scale * value:.{decimals}f}"


def gait_text(gait: Mapping[str, Any] | None) -> str:
    """The gait of a row in words, empty where it has none."""
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
STATE = "state"  # of the files: a column, too, but not one of a run


def bag_rows(
    folder: Path, parameters: str, progress: Callable[[float], None]
) -> tuple[list[Row], int]:
    """(the rows of all runs below a folder, or of one bag; how many bags were read anew).

    What was recovered from a bag is listed instead of it.
    ``parameters`` is a parameter file; empty: the one inside each bag, else the paper's. Raises `InputError` where
    there is no bag.
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
        _keep(index, {name: known[name] for name in marks})
    rows = [{"bag": str(bag), **row} for bag in bags for row in known[str(bag)][1]]
    return rows, len(todo)


def _index_file(folder: Path, parameters: str) -> Path:
    content = Path(parameters).read_bytes() if parameters else b""
    keys = [column.key for column in COLUMNS]
    name = f"{FIGURES_VERSION} {keys}\n".encode() + os.fsencode(folder.resolve()) + b"\n" + content
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser())
    return home / "worm_model" / f"bags-{hashlib.sha256(name).hexdigest()[:16]}.json"


def _known(index: Path) -> dict[str, Any]:
    """What an index holds; nothing where it is missing or not one."""
    try:
        content = json.loads(index.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}


def _keep(index: Path, content: dict[str, Any]) -> None:
    """An index that cannot be kept is made again the next time."""
    with suppress(OSError):
        index.parent.mkdir(parents=True, exist_ok=True)
        part = index.with_name(f"{index.name}.{os.getpid()}")
        part.write_text(json.dumps(content), encoding="utf-8")
        part.replace(index)


def _read(bag: Path, parameters: str) -> list[Row]:
    """The rows of a bag; one that cannot be read as it is has one that says why, and is left as it is."""
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
    """Return a table without the columns that have a title alone, such as the conditions on level ground."""
    columns = zip(*lines, strict=True)
    filled = [column for column in columns if set(column[1:]) - {"", MISSING}]
    return [list(row) for row in zip(*filled, strict=True)]


def describe(rows: Sequence[Row], folder: Path) -> str:
    """The table for people."""
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
