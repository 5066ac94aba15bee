# SPDX-License-Identifier: Apache-2.0
"""Lab with a robot that the model does not contain: runs and bench tests, in the files that `identify` reads."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from foreign_robot import Camera, ForeignRobot, crawl
from lab_files import add_run, write_bench_tests

from worm_model.gait import Gait
from worm_model.identification.inputs import BenchTest

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
