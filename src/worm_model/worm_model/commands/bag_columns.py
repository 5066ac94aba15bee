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

CLOSED, OPEN, DAMAGED, UNREADABLE = "closed", "not closed", "damaged", "unreadable"
NO_RUN = "no run"  # state of an intact bag without a run of the worm
MISSING = "–"


@dataclass(frozen=True)
class Number:
    """Text of a number that is multiplied by ``scale`` and rounded to ``decimals``."""

    scale: float
    decimals: int

    def __call__(self, value: float) -> str:
        """Return the text of a value."""
        return MISSING if math.isnan(value) else f"{self.scale * value:.{self.decimals}f}"


@dataclass(frozen=True)
class RunColumn:
    """Column of the table of recorded runs. To add a column, add a row to COLUMNS.

    Attributes:
        key: key of the value in a row and in `--json`.
        title: title in the printed table; empty: the column is not printed.
        value: returns the value from the `bag_runs.RunFigures` of a run.
        text: returns the printed text of a value that is not None.
        label: title in the console's list; empty: the list does not contain the column.
    """

    key: str
    title: str
    value: Callable[[Any], Any]
    text: Callable[[Any], str] = str
    label: str = ""

    def cell(self, row: Mapping[str, Any]) -> Any:
        """Return the value of a row for a sortable list: a rounded number, or a text; None if it is missing."""
        value = row.get(self.key)
        if value is None or value != value:
            return None
        if isinstance(self.text, Number):
            return round(self.text.scale * value, self.text.decimals)
        return self.text(value)


def _gait_text(gait: Mapping[str, Any]) -> str:
    """Return the gait of a row as text: stroke, frequency and direction."""
    way = "" if gait["direction"] > 0 else " reverse"
    return f"{1e3 * gait['stroke']:.1f} mm {gait['frequency']:.3f} Hz{way}"


def _local_time(start: str) -> str:
    """Return the ``start`` of a row (ISO 8601) in local time to the second, like the names of bags."""
    return datetime.fromisoformat(start).astimezone().strftime("%Y-%m-%d %H:%M:%S")


COLUMNS = (
    RunColumn("start", "start", lambda run: run.start, _local_time, "start"),
    RunColumn("duration_s", "s", lambda run: run.duration_s, Number(1.0, 1)),
    RunColumn("gait", "gait", lambda run: named_values(run.played.gait), _gait_text, "gait"),
    RunColumn(
        "conditions",
        "conditions",
        lambda run: asdict(run.conditions),
        lambda values: "" if (stated := Conditions(**values)) == LEVEL else str(stated),
    ),
    RunColumn("cycles", "cycles", lambda run: run.cycles, Number(1.0, 0), "cycles"),
    RunColumn("groove_phase", "φ mm", lambda run: run.groove_phase, Number(1e3, 2)),
    RunColumn("grooves_per_cycle", "grooves", lambda run: run.grooves_per_cycle, Number(1.0, 2)),
    RunColumn("speed", "mm/s", lambda run: run.speed, Number(1e3, 2), "speed, mm/s"),
    RunColumn("power", "W", lambda run: run.power, Number(1.0, 2), "power, W"),
    RunColumn(
        "cost_of_transport",
        "COT",
        lambda run: run.cost_of_transport,
        Number(1.0, 1),
        "cost of transport",
    ),
    RunColumn("rear_margin_m", "", lambda run: run.margins["rear_margin_m"]),
    RunColumn("front_margin_m", "", lambda run: run.margins["front_margin_m"]),
    RunColumn("keeps_probability", "", lambda run: run.margins["keeps_probability"]),
    RunColumn("margin_m", "margin mm", lambda run: run.margin, Number(1e3, 1), "margin, mm"),
    RunColumn("health", "health", lambda run: run.report.health.name.lower(), label="health"),
    RunColumn("notes", "", lambda run: run.notes),
)
STATE = "state"  # key of the state of the files, which belongs to a bag, not to a run
