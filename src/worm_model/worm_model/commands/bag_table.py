# SPDX-License-Identifier: Apache-2.0
"""What was recorded: a row for each run of each bag below a folder, from an index of what was read before."""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from worm_model.bags.finding import bags_below, mark_of, name_below
from worm_model.errors import InputError

Row = dict[str, Any]

CLOSED, OPEN, DAMAGED = "closed", "not closed", "damaged"
NUMBERS = (
    *("groove_phase", "grooves_per_cycle", "speed", "power", "cost_of_transport"),
    *("duration_s", "cycles"),
)
INDEX_VERSION = 2  # of a row's content: raise it where a figure is computed otherwise


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
    name = f"{INDEX_VERSION}\n{folder.resolve()}\n".encode() + content
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
    from worm_model.bags.run_manifest import ManifestError
    from worm_model.commands.bag_runs import rows_of_bag, state_of_bag

    empty: Row = {"start": None, "gait": None, **dict.fromkeys(NUMBERS), "health": None}
    try:
        state, reason = state_of_bag(bag)
        if state != CLOSED:
            return [{**empty, "state": state, "notes": reason}]
        return [{**empty, "state": CLOSED, **row} for row in rows_of_bag(bag, parameters)]
    except (InputError, OSError) as error:
        state = CLOSED if isinstance(error, ManifestError) else DAMAGED
        return [{**empty, "state": state, "notes": " ".join(str(error).split())}]


def gait_text(row: Row) -> str:
    """The gait of a row in words, empty where it has none."""
    gait = row["gait"]
    if gait is None:
        return ""
    way = "" if gait["direction"] > 0 else " reverse"
    return f"{1e3 * gait['stroke']:.1f} mm {gait['frequency']:.3f} Hz{way}"


def describe(rows: Sequence[Row], folder: Path) -> str:
    """The table for people."""
    head = ("bag", "start", "s", "gait", "cycles", "φ mm", "grooves", "mm/s", "W", "COT", "health")
    lines = [head]
    notes = []
    for row in rows:
        bag = Path(row["bag"])
        name = name_below(folder, bag)
        lines.append(
            (
                name,
                (row["start"] or "–")[:19],
                _number(row["duration_s"], 1.0, 1),
                gait_text(row) or "–",
                _number(row["cycles"], 1.0, 0),
                _number(row["groove_phase"], 1e3, 2),
                _number(row["grooves_per_cycle"], 1.0, 2),
                _number(row["speed"], 1e3, 2),
                _number(row["power"], 1.0, 2),
                _number(row["cost_of_transport"], 1.0, 1),
                row["health"] or row["state"],
            )
        )
        if row["notes"]:
            notes.append(f"{name}: {row['notes']}")
    widths = [max(len(line[k]) for line in lines) for k in range(len(head))]
    table = [
        "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip()
        for line in lines
    ]
    return "\n".join([*table, *dict.fromkeys(notes)])


def _number(value: float | None, scale: float, decimals: int) -> str:
    return "–" if value is None or math.isnan(value) else f"{scale * value:.{decimals}f}"
