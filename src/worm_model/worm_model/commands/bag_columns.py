# SPDX-License-Identifier: Apache-2.0
"""Columns of the table of recorded runs, and the states of a bag's files."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from datetime import datetime
from typing import Any

from worm_model.gait import named_values
from worm_msgs.conditions import LEVEL, Conditions

CLOSED, OPEN, DAMAGED = "closed", "not closed", "damaged"
MISSING = "–"


@dataclass(frozen=True)
class Column:
    """Column of the table of recorded runs. To add a column, add a row to COLUMNS.

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
    """Return the gait of a row as text: stroke, frequency and direction; empty without a gait."""
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
