# SPDX-License-Identifier: Apache-2.0
"""Traces of a recorded run on a common time grid. As a program, this module prints the traces of a bag as JSON."""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from worm_model.arrays import Array, Stamps
from worm_model.bags.opening import open_bag
from worm_model.bags.recording.run_manifest import recorded_robot
from worm_model.bags.run_reader import read_run
from worm_model.commands.command_line import FAILED, InputError, notifier
from worm_model.gait import FORWARD
from worm_model.parameters import Parameters
from worm_model.run import Run, seconds
from worm_model.twin.data.records import NANOSECONDS, StateRecord
from worm_model.twin.offline_replay import Replay, replay_run
from worm_model.twin.scene import PositionSample
from worm_optimizer.console.picture import picture

POINTS = 3000  # largest number of points of a trace
SHORTEST_STEP_S = 0.01
LATEST_S = 0.2  # a sample that is older than this plus one step of the time grid is ignored, s
# Fields of StateRecord that the picture needs
_TWIN = ("rear_position", "front_position", "rear_anchor", "front_anchor")


@dataclass(frozen=True)
class RunTraces:
    """Values of a run on a time grid: at each time the latest sample, NaN if there is no recent one (see `_at`).

    Attributes:
        name: name of the bag.
        time_s: time since the onset of the first gait, s, shape (n,). In a run without a gait, since the first sample.
        traces: lengths and positions in m, powers in W, by name, shape (n,) each.
        twin: fields of StateRecord that the picture needs, by name, shape (n,) each.
        direction: direction of the latest gait, 0 before the first, shape (n,).
        parameters: parameters of the twin.
    """

    name: str
    time_s: Array
    traces: Mapping[str, Array]
    twin: Mapping[str, Array]
    direction: Array
    parameters: Parameters

    @classmethod
    def from_json(cls, name: str, text: str) -> RunTraces:
        """Return traces from the output of this program."""
        content = json.loads(text)
        arrays = {
            key: {field: np.array(values, float) for field, values in content[key].items()}
            for key in ("traces", "twin")
        }
        return cls(
            name=name,
            time_s=np.array(content["time_s"], float),
            direction=np.array(content["direction"], float),
            parameters=Parameters(**content["parameters"]),
            **arrays,
        )

    def to_json(self) -> str:
        """Return the traces as JSON, with null for NaN."""
        content = {
            "time_s": _values(self.time_s),
            "traces": {name: _values(values) for name, values in self.traces.items()},
            "twin": {name: _values(values) for name, values in self.twin.items()},
            "direction": _values(self.direction),
            "parameters": asdict(self.parameters),
        }
        return json.dumps(content)

    def row_at(self, time_s: float) -> int:
        """Return the last row that is not after a time; the first row for a time before the recording."""
        return int(
            np.clip(np.searchsorted(self.time_s, time_s, "right") - 1, 0, len(self.time_s) - 1)
        )

    def picture_at(self, time_s: float) -> str:
        """Return a picture of the robot in its pipe at a time, as SVG."""
        row = self.row_at(time_s)
        state = {name: float(values[row]) for name, values in self.twin.items()}
        if not all(map(math.isfinite, state.values())):
            return picture(None, PositionSample(), self.parameters)
        zeros: dict[str, Any] = {field.name: 0 for field in fields(StateRecord)}
        rear, front = (float(self.traces[name][row]) for name in ("x1", "x2"))
        direction = int(self.direction[row]) or FORWARD
        return picture(
            StateRecord(**{**zeros, **state}),
            PositionSample(rear, front),
            self.parameters,
            direction,
        )


def traces_of(run: Run, replay: Replay, parameters: Parameters, name: str = "") -> RunTraces:
    """Return the traces of a run and of its replay by the twin. Raises `InputError` if there are no samples."""
    states = replay.states
    sources: dict[str, tuple[Stamps, Array]] = {
        "commanded": (run.commanded.stamp, run.commanded.length),
        "cable": (run.cable.stamp, run.cable.length),
        "measured": (run.measured.stamp, run.measured.length),
        "estimated": (states["stamp_ns"], states["length"]),
        "power": (run.power.stamp, run.power.valid_power),
        "predicted": (states["stamp_ns"], states["power"]),
        "x1": (run.tracker.stamp, run.tracker.rear_position),
        "x2": (run.tracker.stamp, run.tracker.front_position),
        "x1 of the twin": (states["stamp_ns"], states["rear_position"]),
    }
    stamps = [stamp for stamp, _ in sources.values() if len(stamp)]
    if not stamps:
        raise InputError(f"{name}: no samples")
    first, last = min(int(s.min()) for s in stamps), max(int(s.max()) for s in stamps)
    gait = run.gait_state
    onsets = [int(gait.onset[rows].min()) for rows in gait.rows_of_runs()]
    step_s = max(SHORTEST_STEP_S, (last - first) * 1e-9 / (POINTS - 1))
    grid = np.arange(first, last + 1, round(step_s * NANOSECONDS), dtype=np.int64)
    return RunTraces(
        name=name,
        time_s=seconds(grid, min(onsets, default=first)),
        traces={key: _at(grid, *source, step_s) for key, source in sources.items()},
        twin={key: _at(grid, states["stamp_ns"], states[key], step_s) for key in _TWIN},
        direction=np.nan_to_num(_at(grid, gait.stamp, gait.direction.astype(float), math.inf)),
        parameters=parameters,
    )


def _at(grid: Stamps, stamp: Stamps, values: Array, step_s: float) -> Array:
    """Return the latest value at each time of a grid.

    It is NaN before the first value, and where the latest value is older than `LATEST_S` + ``step_s`` (s).
    """
    if not len(stamp):
        return np.full(len(grid), math.nan)
    order = np.argsort(stamp, kind="stable")
    stamp, values = stamp[order], values[order]
    row = np.searchsorted(stamp, grid, "right") - 1
    age = (grid - stamp[np.maximum(row, 0)]) * 1e-9
    fresh: NDArray[np.bool_] = (row >= 0) & (age <= LATEST_S + step_s)
    return np.where(fresh, values[np.maximum(row, 0)], math.nan)


def _values(values: Array) -> list[Any]:
    return [round(value, 6) if math.isfinite(value) else None for value in values.tolist()]


def main() -> int:
    """Print the traces of a bag as JSON."""
    parser = argparse.ArgumentParser()
    parser.add_argument("bag", type=Path)
    parser.add_argument("--parameters", default="")
    options = parser.parse_args()
    notify = notifier("traces")
    try:
        with open_bag(options.bag, notify) as bag:
            run, robot = read_run(bag), recorded_robot(bag, options.parameters)
        parameters = robot.parameters
        traces = traces_of(run, replay_run(run, parameters), parameters, str(options.bag))
    except InputError as error:
        notify(str(error))
        return FAILED
    sys.stdout.write(traces.to_json())
    return 0


if __name__ == "__main__":
    sys.exit(main())
