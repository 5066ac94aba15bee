# SPDX-License-Identifier: Apache-2.0
"""Lab with a robot that the model does not contain: runs and bench tests, in the files that `identify` reads."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from foreign_robot import Camera, ForeignRobot, crawl
from lab_files import write_logs, write_table

from worm_model.gait import Gait

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
    folder.mkdir(parents=True)
    gaits = {}
    for number, (gait, cycles) in enumerate(plan, 1):
        name = f"run_{number:02}"
        write_logs(folder / name, crawl(robot, gait, cycles, camera, number).run)
        gaits[name] = {"stroke_m": gait.stroke, "frequency_Hz": gait.frequency}
    (folder / "runs.json").write_text(json.dumps(gaits))
    random = np.random.default_rng([robot.pipe, 13])
    _write_bench_tests(folder, robot, random)
    mass = 1e-3 * np.round(1e3 * (robot.mass + random.normal(0.0, 5e-4, 2)))
    length = robot.free_length + random.normal(0.0, 2.5e-4)
    pitch = robot.pitch + random.normal(0.0, 2.5e-5)
    (folder / "README.md").write_text(
        f"M1 = {mass[0]:.3f} kg, M2 = {mass[1]:.3f} kg, L_free = {length:.4f} m, d = {pitch:.5f} m\n"
    )
    return folder


def _write_bench_tests(folder: Path, robot: ForeignRobot, random: np.random.Generator) -> None:
    """Write both tests, each up and down again, with hysteresis and noise."""
    up = np.linspace(0.0, 0.07, 18)
    compression = np.concatenate([up, up[::-1]])
    way = np.repeat([0.5, -0.5], up.size)
    force = robot.bellows_stiffness * compression + BELLOWS_HYSTERESIS_N * way
    noise = random.normal(0.0, FORCE_NOISE_N, (2, 96))
    write_table(folder / "bellows.csv", "compression_m,force_N", compression, force + noise[0, :36])
    out = np.linspace(-0.012, 0.012, 48)
    x = np.concatenate([out, out[::-1]])
    half = 0.5 * robot.clearance
    force = robot.engaged_stiffness * np.minimum(x + half, 0.0)
    force += robot.disengaged_stiffness * np.maximum(x - half, 0.0)
    way = np.repeat([0.5, -0.5], out.size) * (np.abs(x) > half)
    write_table(
        folder / "fin.csv", "displacement_m,force_N", x, force + robot.hysteresis_N * way + noise[1]
    )
