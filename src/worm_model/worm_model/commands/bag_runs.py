# SPDX-License-Identifier: Apache-2.0
"""The runs of one bag, each with its figures: the twin follows the bag, the numbers are those of the analysis."""

from __future__ import annotations

import math
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from worm_model.analysis.replay_metrics import RunReport, report_replay
from worm_model.analysis.run_metrics import (
    END_TOLERANCE_NS,
    PlayedGait,
    RecordingError,
    accumulated_energy,
    averaged_cycles,
    early_end,
    mean_rate,
)
from worm_model.bags.bag import Bag
from worm_model.bags.bag_metadata import read_metadata
from worm_model.bags.finding import METADATA_FILE
from worm_model.bags.opening import are_sound, is_unfinished, open_bag
from worm_model.bags.run_manifest import RUN_RECORD, recorded_parameters
from worm_model.bags.run_reader import read_run
from worm_model.bags.worm_topics import TWIN_INPUTS
from worm_model.commands.bag_table import CLOSED, DAMAGED, OPEN
from worm_model.parameters import Parameters, load_parameters
from worm_model.run import Run, utc_of
from worm_model.simulation.simulator import cost_of_transport
from worm_model.twin.offline_replay import Replay, replay_run

RECOVER = "./worm run worm_model recover makes a whole bag of it"


def state_of_bag(path: Path) -> tuple[str, str]:
    """(state, why it is no better): what opening would first have to recover is not opened."""
    if path.is_dir() and (
        not (path / METADATA_FILE).is_file() or is_unfinished(read_metadata(path))
    ):
        return OPEN, f"it is being recorded, or its recorder was killed: {RECOVER}"
    files = sorted(path.glob("*.mcap")) if path.is_dir() else [path]
    if not files or files[0].suffix != ".mcap" or are_sound(files):
        return CLOSED, ""
    return DAMAGED, f"parts of it are spoilt: {RECOVER}"


def rows_of_bag(path: Path, parameters: str) -> list[dict[str, Any]]:
    """A row for each run of a closed bag; one without a run says so. Raises `InputError` if it cannot be read."""
    remarks: list[str] = []
    with open_bag(path, remarks.append) as bag:
        run = read_run(bag, names=TWIN_INPUTS)
        values = load_parameters(parameters) if parameters else _own_parameters(bag)
        record = bag.metadata.get(RUN_RECORD, {})
        span = (bag.end - bag.start) * 1e-9
        start = bag.start
    notes = [f"{key[5:]}: {text}" for key, text in record.items() if key.startswith("note.")]
    replay = replay_run(run, values)
    reports = report_replay(run, replay, values.pitch).runs
    if not reports:
        said = "; ".join(["no gait was run", *notes, *remarks])
        return [{"start": utc_of(start), "duration_s": span, "notes": said}]
    return [_row(run, replay, report, values, [*notes, *remarks]) for report in reports]


def _own_parameters(bag: Bag) -> Parameters:
    content = recorded_parameters(bag)
    return Parameters() if content is None else content.parameters


def _row(
    run: Run, replay: Replay, report: RunReport, p: Parameters, notes: list[str]
) -> dict[str, Any]:
    played = report.played
    gait = played.gait
    first, last = averaged_cycles(run, played)
    window = played.cycle_window(first, last)
    speed = _rate(window, (run.tracker.stamp, run.tracker.rear_position), "position")
    speed *= gait.direction
    power = _rate(window, accumulated_energy((run.power.stamp, run.power.valid_power)), "power")
    states = replay.states
    after = states["groove_phase"][states["stamp_ns"] >= played.onset]
    cost = float(cost_of_transport(speed, power, p.mass)) if speed > 0.0 else math.nan
    early = early_end(run, played)
    return {
        "start": utc_of(played.onset),
        "duration_s": sum(cycle.complete for cycle in report.cycles) * gait.period,
        "gait": asdict(gait),
        "cycles": played.whole_cycles_until(_last(run, played)),
        "groove_phase": float(after[0]) if after.size else math.nan,
        "grooves_per_cycle": speed / gait.frequency / p.pitch,
        "speed": speed,
        "power": power,
        "cost_of_transport": cost,
        "health": report.health.name.lower(),
        "notes": "; ".join(filter(None, [early, *notes])),
    }


def _last(run: Run, played: PlayedGait) -> int:
    if played.end is not None:
        return played.end + END_TOLERANCE_NS
    return int(np.max(run.commanded.stamp, initial=0))


def _rate(window: Any, samples: Any, name: str) -> float:
    """NaN where the instrument did not see the averaged cycles."""
    try:
        return mean_rate(samples, window, name)
    except RecordingError:
        return math.nan
