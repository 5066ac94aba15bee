# SPDX-License-Identifier: Apache-2.0
"""Files of a lab for tests: bench tests of a bellows and a fin, and a folder of raw logs of a run."""

import json
from pathlib import Path

import numpy as np
from recorded_run import GAIT, REST_S, simulated_run

from worm_model.parameters import PAPER
from worm_model.run import Run

_RADIUS = 0.012  # m, of the spool
_TICKS = 4096  # per turn
_ONSET_S = 2.0  # of a lab's runs


def write_bench_tests(folder: Path) -> tuple[Path, Path]:
    """Write bellows.csv and fin.csv of the paper's robot, with noise of 20 mN."""
    compression = np.linspace(0.0, 0.06, 13)
    stretch = np.linspace(-0.008, 0.008, 65)
    force = PAPER.engaged_stiffness * np.minimum(stretch + 0.5 * PAPER.clearance, 0.0)
    force += PAPER.disengaged_stiffness * np.maximum(stretch - 0.5 * PAPER.clearance, 0.0)
    noise = np.random.default_rng(1)
    bellows, fin = folder / "bellows.csv", folder / "fin.csv"
    for path, head, x, y in (
        (bellows, "compression_m,force_N", compression, PAPER.bellows_stiffness * compression),
        (fin, "displacement_m,force_N", stretch, force),
    ):
        write_table(path, head, x, y + noise.normal(0.0, 0.02, y.size))
    return bellows, fin


def write_lab(folder: Path, name: str = "run_01", cycles: int = 5) -> Path:
    """Add a run to a lab's folder: camera, power sensor and servo of `recorded_run`, and the bench tests."""
    gaits = folder / "runs.json"
    listed = json.loads(gaits.read_text()) if gaits.exists() else {}
    write_logs(folder / name, simulated_run(cycles, seed=len(listed)), _ONSET_S - REST_S)
    gait = {"stroke_m": GAIT.stroke, "frequency_Hz": GAIT.frequency}
    gaits.write_text(json.dumps({**listed, name: gait}))
    write_bench_tests(folder)
    return folder


def write_logs(folder: Path, run: Run, start_s: float = 0.0) -> None:
    """Write camera.csv, power.csv and servo.csv of a run, whose clock begins at a time in s."""
    folder.mkdir(parents=True)

    def time(stamp: np.ndarray) -> np.ndarray:
        return (stamp - run.origin) * 1e-9 + start_s

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
