# SPDX-License-Identifier: Apache-2.0
"""Runs of one bag with their metrics, from the analysis and from a replay of the bag with the twin."""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
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
from worm_model.commands import bag_columns
from worm_model.errors import InputError, RecordingError
from worm_model.margin.half_cycles import Fin
from worm_model.margin.measured_margin import measure_cycles
from worm_model.parameters import Parameters
from worm_model.run import Run, utc_of
from worm_model.simulation.simulator import cost_of_transport
from worm_model.text_table import text_table
from worm_model.twin.offline_replay import Replay, replay_run
from worm_msgs.conditions import Conditions

_SAVE = f"{RECOVER} writes its readable messages to a new bag"


def rows_of_bag(path: Path, parameters: str) -> list[dict[str, Any]]:
    """Return a row for each run of a closed bag, or a single row that states why there is none.

    ``parameters`` is the path of a parameter file; empty: the file in the bag, else the paper's values.
    """
    if path.is_dir():
        for file in path.iterdir():
            if file.is_file():
                file.open("rb").close()
        if is_unclosed(path):
            text = f"it is being recorded, or its recorder was killed: {_SAVE}"
            return [{bag_columns.STATE: bag_columns.OPEN, "notes": text}]
    remarks: list[str] = []
    with open_bag(path, remarks.append) as bag:
        if bag.damage:
            return [
                {
                    bag_columns.STATE: bag_columns.DAMAGED,
                    "notes": f"{'; '.join(bag.damage)}: {_SAVE}",
                }
            ]
        try:
            rows = _rows_of_runs(bag, parameters, remarks)
        except NoRunError as error:
            rows = []
            remarks.insert(0, str(error))
        except BagError as error:
            return [{bag_columns.STATE: bag_columns.CLOSED, "notes": str(error)}]
        if rows:
            return [{bag_columns.STATE: bag_columns.CLOSED, **row} for row in rows]
        start = utc_of(bag.start) if bag.message_count else None
        notes = "; ".join(remarks)
        return [
            {
                bag_columns.STATE: bag_columns.NO_RUN,
                "start": start,
                "duration_s": bag.duration_s,
                "notes": notes,
            }
        ]


def _rows_of_runs(bag: Bag, parameters: str, remarks: list[str]) -> list[dict[str, Any]]:
    """Return a row for each run. Raises `NoRunError` if the bag contains none."""
    run = read_run(bag, names=REPLAY_INPUTS)
    values, conditions = recorded_robot(bag, parameters).parameters, recorded_conditions(bag)
    record = bag.metadata.get(RUN_RECORD, {})
    remarks[:0] = [f"{key[5:]}: {text}" for key, text in record.items() if key.startswith("note.")]
    replay = replay_run(run, values)
    reports = report_replay(run, replay, values.pitch).runs
    if not reports:
        raise NoRunError("no gait was run")
    offset_ns = clock_offset(bag, "")
    figures = [RunFigures(run, replay, r, values, conditions, offset_ns, remarks) for r in reports]
    return [{column.key: column.value(f) for column in bag_columns.COLUMNS} for f in figures]


@dataclass(frozen=True)
class RunFigures:
    """Metrics of one run for `bag_columns.COLUMNS`. Metrics that cannot be computed are NaN.

    Attributes:
        run: samples of the whole bag, which may contain several runs.
        replay: replay of the bag with the twin.
        report: report of the replay on this run.
        parameters: parameters of the robot.
        conditions: recorded conditions.
        clock_offset_ns: recorder's clock minus the clock of the stamps, ns, see `run_reader.clock_offset`.
        remarks: the operator's notes, and remarks on the bag.
    """

    run: Run
    replay: Replay
    report: RunReport
    parameters: Parameters
    conditions: Conditions
    clock_offset_ns: int
    remarks: Sequence[str]

    @property
    def played(self) -> run_metrics.PlayedGait:
        """The gait of the run, with its onset and its end."""
        return self.report.played

    @property
    def start(self) -> str:
        """Onset in UTC according to the recorder's clock, which also determines the bag's name.

        The onset in the messages of a virtual robot may lag behind the recorder's clock.
        """
        return utc_of(self.played.onset + self.clock_offset_ns)

    @property
    def duration_s(self) -> float:
        """Duration of the complete cycles, s."""
        return sum(cycle.complete for cycle in self.report.cycles) * self.played.gait.period

    @property
    def cycles(self) -> int:
        """Number of whole cycles that were played."""
        return self.played.whole_cycles_until(_last(self.run, self.played))

    @property
    def groove_phase(self) -> float:
        """Groove phase at the onset, m."""
        states = self.replay.states
        after = states["groove_phase"][states["stamp_ns"] >= self.played.onset]
        return float(after[0]) if after.size else math.nan

    @cached_property
    def speed(self) -> float:
        """Mean speed along the gait's direction over the averaged cycles, m/s."""
        tracker = self.run.tracker
        rate = _rate(self._window, (tracker.stamp, tracker.rear_position), "position")
        return rate * self.played.gait.direction

    @cached_property
    def power(self) -> float:
        """Mean power over the averaged cycles, W."""
        power = self.run.power
        return _rate(
            self._window, run_metrics.accumulated_energy((power.stamp, power.valid_power)), "power"
        )

    @property
    def grooves_per_cycle(self) -> float:
        """Mean displacement per averaged cycle, in pitches."""
        return self.speed / self.played.gait.frequency / self.parameters.pitch

    @property
    def cost_of_transport(self) -> float:
        """Cost of transport, 1."""
        if not self.speed > 0.0:
            return math.nan
        return float(cost_of_transport(self.speed, self.power, self.parameters.mass))

    @cached_property
    def margins(self) -> dict[str, Any]:
        """Measured margins, see `RunMargin.as_json`."""
        played = self.played
        measured = measure_cycles(self.run, played.gait, played.onset, self.cycles, self.parameters)
        return measured.as_json()

    @property
    def margin(self) -> float:
        """Smaller mean margin of both fins, m; NaN unless both were measured."""
        fins = [self.margins[f"{fin.value}_margin_m"] for fin in Fin]
        return math.nan if None in fins else float(min(fins))

    @property
    def notes(self) -> str:
        """Reasons for an early end and for missing judgements, the operator's notes, and remarks on the bag."""
        early = run_metrics.early_end(self.run, self.played)
        return "; ".join(filter(None, [early, *_not_judged(self.report), *self.remarks]))

    @cached_property
    def _window(self) -> run_metrics.Window | None:
        """Averaged cycles; None without a completed cycle."""
        first, last = run_metrics.averaged_cycles(self.run, self.played)
        completed = run_metrics.completed_cycles(self.run, self.played)
        return self.played.cycle_window(first, last) if completed else None


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
    content = {
        key: entry
        for key, entry in content.items()
        if entry[1][0][bag_columns.STATE] != bag_columns.UNREADABLE
    }
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
        rows = [{bag_columns.STATE: bag_columns.UNREADABLE, "notes": str(error)}]
    except InputError as error:
        rows = [{bag_columns.STATE: bag_columns.DAMAGED, "notes": str(error)}]
    return [{**empty, **row, "notes": " ".join(row["notes"].split())} for row in rows]


def _without_empty(lines: Sequence[Sequence[str]]) -> list[list[str]]:
    """Return a table without empty columns, such as the conditions on level ground."""
    columns = zip(*lines, strict=True)
    filled = [column for column in columns if set(column[1:]) - {"", bag_columns.MISSING}]
    return [list(row) for row in zip(*filled, strict=True)]


def describe(rows: Sequence[Row], folder: Path) -> str:
    """Return the table as text."""
    shown = [column for column in bag_columns.COLUMNS if column.title]
    lines = [["bag", *(column.title for column in shown)]]
    notes = []
    for row in rows:
        name = name_below(folder, Path(row["bag"]))
        values = {**row, "health": row["health"] or row[bag_columns.STATE]}
        cells = (
            bag_columns.MISSING if values[c.key] is None else c.text(values[c.key]) for c in shown
        )
        lines.append([name, *cells])
        if row["notes"]:
            notes.append(f"{name}: {row['notes']}")
    lines = _without_empty(lines)
    return "\n".join([text_table(lines), *dict.fromkeys(notes)])
