# SPDX-License-Identifier: Apache-2.0
"""Files of a lab for tests: bench tests of a bellows and a fin, and raw logs of runs, also of a foreign robot."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from foreign_robot import Camera, ForeignRobot, crawl
from recorded_run import GAIT, simulated_run
from virtual_campaign import bench_tests

from worm_model.gait import Gait
from worm_model.identification.inputs import BenchTest
from worm_model.parameters import PAPER
from worm_model.run import Run

_RADIUS = 0.012  # m, of the spool
_TICKS = 4096  # per turn
_ONSET_S = 2.0  # of a lab's runs
# Gaits and cycles that pass five ridges
PLAN = (
    (Gait(0.06, 0.08), 7),
    (Gait(0.06, 0.12), 7),
    (Gait(0.065, 0.18), 7),
    (Gait(0.07, 0.10), 7),
    (Gait(0.07, 0.15), 7),
    (Gait(0.075, 0.12), 5),
    (Gait(0.08, 0.10), 4),
    (Gait(0.08, 0.18), 4),
    (Gait(0.08, 0.24), 5),
    (Gait(0.09, 0.15), 4),
)
USUAL_CAMERA = Camera()
FORCE_NOISE_N = 0.15
BELLOWS_HYSTERESIS_N = 0.4


def write_bench_tests(folder: Path, tests: Sequence[BenchTest] = ()) -> None:
    """Write bellows.csv and fin.csv, of the paper's robot if no tests are given."""
    bellows, fin = tests or bench_tests(PAPER, np.random.default_rng(1))
    write_table(folder / "bellows.csv", "compression_m,force_N", bellows.x, bellows.y)
    write_table(folder / "fin.csv", "displacement_m,force_N", fin.x, fin.y)


def write_lab(folder: Path, name: str = "run_01") -> Path:
    """Add a run to a lab's folder: camera, power sensor and servo of `recorded_run`, and the bench tests."""
    add_run(folder, name, GAIT, simulated_run(5, seed=len(list(folder.glob("run*/")))))
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


def write_foreign_lab(
    folder: Path,
    robot: ForeignRobot,
    camera: Camera = USUAL_CAMERA,
    plan: Sequence[tuple[Gait, int]] = PLAN,
) -> Path:
    """Write the folder of a lab: one run per gait of the plan, all from the same grooves, and the bench tests."""
    for number, (gait, cycles) in enumerate(plan, 1):
        add_run(folder, f"run_{number:02}", gait, crawl(robot, gait, cycles, camera, number).run)
    random = np.random.default_rng([robot.pipe, 13])
    write_bench_tests(folder, _bench_tests(robot, random))
    mass = 1e-3 * np.round(1e3 * (robot.mass + random.normal(0.0, 5e-4, 2)))
    length = robot.free_length + random.normal(0.0, 2.5e-4)
    pitch = robot.pitch + random.normal(0.0, 2.5e-5)
    (folder / "README.md").write_text(
        f"M1 = {mass[0]:.3f} kg, M2 = {mass[1]:.3f} kg, L_free = {length:.4f} m, d = {pitch:.5f} m\n"
    )
    return folder


def _bench_tests(robot: ForeignRobot, random: np.random.Generator) -> list[BenchTest]:
    """Return both tests, each up and down again, with hysteresis and noise."""
    compression, x = np.linspace(0.0, 0.07, 18), np.linspace(-0.012, 0.012, 48)
    beyond = x - np.clip(x, -0.5 * robot.clearance, 0.5 * robot.clearance)
    stiffness = np.where(x < 0.0, robot.engaged_stiffness, robot.disengaged_stiffness)
    tests = []
    for at, force, hysteresis in (
        (compression, robot.bellows_stiffness * compression, BELLOWS_HYSTERESIS_N),
        (x, stiffness * beyond, robot.hysteresis_N * (beyond != 0.0)),
    ):
        seen = np.concatenate([force + 0.5 * hysteresis, (force - 0.5 * hysteresis)[::-1]])
        seen += random.normal(0.0, FORCE_NOISE_N, seen.size)
        tests.append(BenchTest(np.concatenate([at, at[::-1]]), seen, ""))
    return tests
