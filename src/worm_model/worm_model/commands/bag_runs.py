# SPDX-License-Identifier: Apache-2.0
"""Table of the recorded runs with their metrics, from the analysis and from a replay of the bags with the twin."""

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

import numpy as np

from worm_model.analysis import run_metrics
from worm_model.analysis.replay_metrics import RunReport, report_replay
from worm_model.bags.formats.bag_errors import RECOVER, BagError, NoRunError
from worm_model.bags.formats.bag_metadata import is_unclosed
from worm_model.bags.formats.finding import bags_below, mark_of, name_below
from worm_model.bags.opening import Bag, open_bag
from worm_model.bags.recording.run_manifest import (
    RUN_RECORD,
    recorded_conditions,
    recorded_robot,
)
from worm_model.bags.run_reader import clock_offset, read_run
from worm_model.bags.worm_topics import REPLAY_INPUTS
from worm_model.errors import InputError, RecordingError
from worm_model.gait import named_values
from worm_model.margin.half_cycles import Fin
from worm_model.margin.measured_margin import measure_cycles
from worm_model.parameters import Parameters
from worm_model.run import Run, utc_of
from worm_model.simulation.simulator import cost_of_transport
from worm_model.text_table import text_table
from worm_model.twin.offline_replay import Replay, replay_run
from worm_msgs.conditions import LEVEL, Conditions

Row = dict[str, Any]

METRICS_VERSION = 6  # Increase this number when the computation of a metric changes.
# Values of the column "state", which describes the files. NO_RUN: an intact bag without a run of the worm.
CLOSED, OPEN, DAMAGED, UNREADABLE = "closed", "not closed", "damaged", "unreadable"
NO_RUN = "no run"
MISSING = "–"
_SAVE = f"{RECOVER} writes its readable messages to a new bag"


# --- columns --------------------------------------------------------------------------------------


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
    """Column of the table of recorded runs. `_row` computes its value.

    Attributes:
        key: key of the value in a row and in `--json`.
        title: title in the printed table; empty: the column is not printed.
        text: returns the printed text of a value that is not None.
        label: title in the console's list; empty: the list does not contain the column.
    """

    key: str
    title: str = ""
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


def _conditions_text(values: Mapping[str, float]) -> str:
    stated = Conditions(**values)
    return "" if stated == LEVEL else str(stated)


COLUMNS = (
    RunColumn("start", "start", _local_time, "start"),
    RunColumn("duration_s", "s", Number(1.0, 1)),
    RunColumn("gait", "gait", _gait_text, "gait"),
    RunColumn("conditions", "conditions", _conditions_text),
    RunColumn("cycles", "cycles", Number(1.0, 0), "cycles"),
    RunColumn("groove_phase", "φ mm", Number(1e3, 2)),
    RunColumn("grooves_per_cycle", "grooves", Number(1.0, 2)),
    RunColumn("speed", "mm/s", Number(1e3, 2), "speed, mm/s"),
    RunColumn("power", "W", Number(1.0, 2), "power, W"),
    RunColumn("cost_of_transport", "COT", Number(1.0, 1), "cost of transport"),
    RunColumn("rear_margin_m"),
    RunColumn("front_margin_m"),
    RunColumn("keeps_probability"),
    RunColumn("margin_m", "margin mm", Number(1e3, 1), "margin, mm"),
    RunColumn("health", "health", label="health"),
    RunColumn("notes"),
)


# --- rows -----------------------------------------------------------------------------------------


def rows_of_bag(path: Path, parameters: str) -> list[Row]:
    """Return a row for each run of a closed bag, or a single row that states why there is none.

    ``parameters`` is the path of a parameter file; empty: the file in the bag, else the paper's values.
    """
    if path.is_dir():
        for file in path.iterdir():
            if file.is_file():
                file.open("rb").close()
        if is_unclosed(path):
            text = f"it is being recorded, or its recorder was killed: {_SAVE}"
            return [{"state": OPEN, "notes": text}]
    remarks: list[str] = []
    with open_bag(path, remarks.append) as bag:
        if bag.damage:
            return [{"state": DAMAGED, "notes": f"{'; '.join(bag.damage)}: {_SAVE}"}]
        try:
            return _rows_of_runs(bag, parameters, remarks)
        except NoRunError as error:
            start = utc_of(bag.start) if bag.message_count else None
            notes = "; ".join([str(error), *remarks])
            return [{"state": NO_RUN, "start": start, "duration_s": bag.duration_s, "notes": notes}]
        except BagError as error:
            return [{"state": CLOSED, "notes": str(error)}]


def _rows_of_runs(bag: Bag, parameters: str, remarks: list[str]) -> list[Row]:
    """Return a row for each run. Raises `NoRunError` if the bag contains none."""
    run = read_run(bag, names=REPLAY_INPUTS)
    values, conditions = recorded_robot(bag, parameters).parameters, recorded_conditions(bag)
    record = bag.metadata.get(RUN_RECORD, {})
    remarks[:0] = [f"{key[5:]}: {text}" for key, text in record.items() if key.startswith("note.")]
    replay = replay_run(run, values)
    reports = report_replay(run, replay, values.pitch).runs
    if not reports:
        raise NoRunError("no gait was run")
    # The onset in the messages of a virtual robot may lag behind the recorder's clock, which also names the bag.
    offset_ns = clock_offset(bag, "")
    rows = [_row(run, replay, report, values, remarks) for report in reports]
    for row, report in zip(rows, reports, strict=True):
        row["start"] = utc_of(report.played.onset + offset_ns)
        row["conditions"] = asdict(conditions)
    return [{"state": CLOSED, **row} for row in rows]


def _row(
    run: Run, replay: Replay, report: RunReport, parameters: Parameters, remarks: Sequence[str]
) -> Row:
    """Return the metrics of one run, by the keys of COLUMNS. Metrics that cannot be computed are NaN.

    Speed, power and grooves are means over the averaged cycles.

    Args:
        run: samples of the whole bag, which may contain several runs.
        replay: replay of the bag with the twin.
        report: report of the replay on this run.
        parameters: parameters of the robot.
        remarks: the operator's notes, and remarks on the bag.
    """
    played, gait = report.played, report.played.gait
    window = None
    if run_metrics.completed_cycles(run, played):
        window = played.cycle_window(*run_metrics.averaged_cycles(run, played))
    tracker, power = run.tracker, (run.power.stamp, run.power.valid_power)
    speed = gait.direction * _rate(window, (tracker.stamp, tracker.rear_position), "position")
    mean_power = _rate(window, run_metrics.accumulated_energy(power), "power")
    cycles = played.whole_cycles_until(_last(run, played))
    states = replay.states
    phase = states["groove_phase"][states["stamp_ns"] >= played.onset]
    margins = measure_cycles(run, gait, played.onset, cycles, parameters).as_json()
    fins = [margins[f"{fin.value}_margin_m"] for fin in Fin]
    cost = math.nan
    if speed > 0.0:
        cost = float(cost_of_transport(speed, mean_power, parameters.mass))
    return {
        "duration_s": sum(cycle.complete for cycle in report.cycles) * gait.period,
        "gait": named_values(gait),
        "cycles": cycles,
        "groove_phase": float(phase[0]) if phase.size else math.nan,
        "grooves_per_cycle": speed / gait.frequency / parameters.pitch,
        "speed": speed,
        "power": mean_power,
        "cost_of_transport": cost,
        "rear_margin_m": margins["rear_margin_m"],
        "front_margin_m": margins["front_margin_m"],
        "keeps_probability": margins["keeps_probability"],
        "margin_m": math.nan if None in fins else float(min(fins)),
        "health": report.health.name.lower(),
        "notes": "; ".join(
            filter(None, [run_metrics.early_end(run, played), *_not_judged(report), *remarks])
        ),
    }


def _not_judged(report: RunReport) -> list[str]:
    """Return the reasons why the twin did not judge a run, or some of its complete cycles."""
    if report.not_judged:
        return [f"not judged: {report.not_judged}"]
    return [
        f"cycle {cycle.number} not judged: {cycle.not_judged}"
        for cycle in report.cycles
        if cycle.complete and cycle.not_judged
    ]


def _last(run: Run, played: run_metrics.PlayedGait) -> int:
    if played.end is not None:
        return played.end + run_metrics.END_TOLERANCE_NS
    return int(np.max(run.commanded.stamp, initial=0))


def _rate(window: run_metrics.Window | None, samples: Any, name: str) -> float:
    """Return the mean rate of samples over the averaged cycles; NaN without a completed cycle or without samples."""
    if window is None:
        return math.nan
    try:
        return run_metrics.mean_rate(samples, window, name)
    except RecordingError:
        return math.nan


def bag_rows(folder: Path, parameters: str, progress: Callable[[float], None]) -> list[Row]:
    """Return the rows of all runs. A bag is read if the index lacks its present state.

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
    return [{"bag": str(bag), **row} for bag in bags for row in known[keys[bag]][1]]


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
    """Write the index without the unreadable bags. The next call reads them again, and all bags if writing fails."""
    content = {key: entry for key, entry in content.items() if entry[1][0]["state"] != UNREADABLE}
    with suppress(OSError):
        index.parent.mkdir(parents=True, exist_ok=True)
        part = index.with_name(f"{index.name}.{os.getpid()}")
        part.write_text(json.dumps(content), encoding="utf-8")
        part.replace(index)


def _read(bag: Path, parameters: str) -> list[Row]:
    """Return the rows of a bag, or one row with the reason why it has none. The bag is not changed."""
    empty: Row = {column.key: None for column in COLUMNS}
    try:
        rows = rows_of_bag(bag, parameters)
    except OSError as error:
        rows = [{"state": UNREADABLE, "notes": str(error)}]
    except InputError as error:
        rows = [{"state": DAMAGED, "notes": str(error)}]
    return [{**empty, **row, "notes": " ".join(row["notes"].split())} for row in rows]


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
        values = {**row, "health": row["health"] or row["state"]}
        cells = (MISSING if values[c.key] is None else c.text(values[c.key]) for c in shown)
        lines.append([name, *cells])
        if row["notes"]:
            notes.append(f"{name}: {row['notes']}")
    lines = _without_empty(lines)
    return "\n".join([text_table(lines), *dict.fromkeys(notes)])
