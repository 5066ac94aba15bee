# SPDX-License-Identifier: Apache-2.0
"""Files of a lab for tests: bench tests of a bellows and a fin, and a folder of raw logs of a run."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from recorded_run import GAIT, simulated_run
from virtual_campaign import bench_tests

from worm_model.gait import Gait
from worm_model.identification.inputs import BenchTest
from worm_model.parameters import PAPER
from worm_model.run import Run

_RADIUS = 0.012  # m, of the spool
_TICKS = 4096  # per turn
_ONSET_S = 2.0  # of a lab's runs


def write_bench_tests(folder: Path, tests: Sequence[BenchTest] = ()) -> None:
    """Write bellows.csv and fin.csv, of the paper's robot if no tests are given."""
    bellows, fin = tests or bench_tests(PAPER, np.random.default_rng(1))
    write_table(folder / "bellows.csv", "compression_m,force_N", bellows.x, bellows.y)
    write_table(folder / "fin.csv", "displacement_m,force_N", fin.x, fin.y)


def write_lab(folder: Path, name: str = "run_01", cycles: int = 5) -> Path:
    """Add a run to a lab's folder: camera, power sensor and servo of `recorded_run`, and the bench tests."""
    add_run(folder, name, GAIT, simulated_run(cycles, seed=len(list(folder.glob("run*/")))))
    write_bench_tests(folder)
    return folder


def add_run(folder: Path, name: str, gait: Gait, run: Run) -> None:
    """Add camera.csv, power.csv and servo.csv of a run to a lab's folder, and its gait to runs.json."""
    gaits = folder / "runs.json"
    listed = json.loads(gaits.read_text()) if gaits.exists() else {}
    write_logs(folder / name, run)
    listed[name] = {"stroke_m": gait.stroke, "frequency_Hz": gait.frequency}
    gaits.write_text(json.dumps(listed))


def write_logs(folder: Path, run: Run) -> None:
    """Write the logs of a run, whose gait begins at `_ONSET_S` of the lab's clock."""
    folder.mkdir(parents=True)

    def time(stamp: np.ndarray) -> np.ndarray:
        return (stamp - run.gait_state.onset.max()) * 1e-9 + _ONSET_S

    tracker, power, command = run.tracker, run.power, run.commanded
    seen = np.isfinite(tracker.rear_position)
    columns = (time(tracker.stamp)[seen], tracker.rear_position[seen], tracker.front_position[seen])
    write_table(folder / "camera.csv", "time_s,x1_m,x2_m", *columns)
    columns = (time(power.stamp), power.bus_voltage, power.power / power.bus_voltage)
    write_table(folder / "power.csv", "time_s,bus_voltage_V,current_A", *columns)
    ticks = np.rint(-command.length_change / (2.0 * np.pi * _RADIUS) * _TICKS)
    write_table(folder / "servo.csv", "time_s,goal_ticks", time(command.stamp), ticks)


def write_table(path: Path, head: str, *columns: np.ndarray) -> None:
    table = np.column_stack(columns)
    np.savetxt(path, table, header=head, comments="", delimiter=",", fmt="%.9g")
