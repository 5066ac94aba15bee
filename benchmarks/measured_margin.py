# SPDX-License-Identifier: Apache-2.0
"""Error of the measured margin on robots that the model does not contain, and predicted against counted losses."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from benchmarks.report import Row, cpu_time
from tests.helpers.foreign_robot import Camera, ForeignRobot, crawl, some_robot
from worm_model.analysis.run_metrics import measure_margin
from worm_model.gait import Gait
from worm_model.margin.half_cycles import Fin
from worm_model.parameters import PAPER

TITLE = (
    "bias and standard deviation of the margin per cycle, and predicted losses of grooves (minutes)"
)
ROBOTS = 4
CYCLES = 6
STEP, MOST = 0.00025, 0.008  # m, of the excess threshold
STROKE = 0.075
FREQUENCIES = (0.1, 0.2, 0.23)
USUAL = Camera()
CAMERAS = {
    **{f"{rate:g} Hz": Camera(rate_hz=rate) for rate in (10.0, 15.0, 60.0, 120.0)},
    **{f"noise {1e3 * noise:g} mm": Camera(noise_m=noise) for noise in (1e-4, 5e-4)},
    "delay 50 ms": Camera(delay_s=0.05),
}
GAITS = ((0.0713, 0.2), (0.073, 0.2), (0.075, 0.2), (0.08, 0.2), (0.08, 0.24), (0.08, 0.3))
GROOVES = 2
PIPES, COUNTED = 12, 20  # robots and cycles for the losses

Margins = dict[Fin, np.ndarray]  # of the cycles that count, m


def _true(robot: ForeignRobot, gait: Gait) -> Margins:
    """Return the excess threshold with which each cycle loses a groove, NaN beyond MOST."""
    promised = int(crawl(robot, gait, CYCLES).grooves(CYCLES, gait.frequency)[1:].max())
    found = {}
    for fin in Fin:
        margin = np.full(CYCLES, np.nan)
        for excess in np.arange(STEP, MOST, STEP):
            larger: dict[str, Any] = {f"{fin.value}_excess": excess}
            changed = dataclasses.replace(robot, **larger)
            lost = crawl(changed, gait, CYCLES).grooves(CYCLES, gait.frequency) < promised
            margin[lost & np.isnan(margin)] = excess - 0.5 * STEP
        # The rear module shows a groove that the front fin lost in the following cycle.
        found[fin] = margin[1:] if fin is Fin.REAR else np.append(np.nan, margin[2:])
    return found


def _errors(truth: Sequence[tuple[ForeignRobot, Gait, Margins]], camera: Camera) -> Margins:
    """Return measured minus true margins."""
    errors: dict[Fin, list[float]] = {fin: [] for fin in Fin}
    for robot, gait, margins in truth:
        run = crawl(robot, gait, CYCLES, camera, seed=robot.pipe).run
        found = measure_margin(run, PAPER)
        for fin in Fin:
            measured = [getattr(cycle, fin.value).margin for cycle in found.cycles]
            own = np.array(measured[1:] if fin is Fin.REAR else measured[:-1])
            errors[fin] += (own - margins[fin][: own.size]).tolist()
    return {fin: np.array(values) for fin, values in errors.items()}


def _row(name: str, errors: Margins) -> Row:
    parts = []
    for fin, values in errors.items():
        known = 1e3 * values[np.isfinite(values)]
        parts.append(f"{fin.value} {known.mean():+.2f} ± {known.std():.2f} mm")
    count = sum(int(np.isfinite(values).sum()) for values in errors.values())
    how = f"measured minus true in {count} half cycles, mean and sd"
    return Row(f"margin, {name}", ", ".join(parts), "0.0 ± 0.5 mm", how)


def _losses() -> list[Row]:
    rows = []
    for stroke, frequency in GAITS:
        gait, predicted, lost = Gait(stroke, frequency), [], []
        for seed in range(PIPES):
            found = measure_margin(
                crawl(some_robot(seed), gait, CYCLES, seed=seed).run, PAPER, GROOVES
            )
            if found.keeps is not None:
                predicted.append(1.0 - found.keeps.value)
            later = crawl(some_robot(seed, pipe=1000 + seed), gait, COUNTED)
            lost.append((later.grooves(COUNTED, frequency)[2:] < GROOVES).mean())
        rows.append(
            Row(
                f"cycles lost, {1e3 * stroke:g} mm at {frequency:g} Hz",
                f"{np.mean(predicted):.1%} predicted, {np.mean(lost):.1%} counted",
                "the same",
                f"{CYCLES} cycles of {len(predicted)} robots; counted in {COUNTED} cycles in other grooves",
            )
        )
    return rows


def run() -> list[Row]:
    """Measure."""
    truth = [
        (robot, gait, _true(robot, gait))
        for robot in map(some_robot, range(ROBOTS))
        for gait in (Gait(STROKE, frequency) for frequency in FREQUENCIES)
    ]
    rows = [
        _row(f"{frequency:g} Hz", _errors([t for t in truth if t[1].frequency == frequency], USUAL))
        for frequency in FREQUENCIES
    ]
    rows += [_row(f"camera {name}", _errors(truth, camera)) for name, camera in CAMERAS.items()]
    recorded = crawl(some_robot(0), Gait(STROKE, 0.2), 10).run
    spent = cpu_time(lambda: measure_margin(recorded, PAPER), 5)
    how = "processor time of ten cycles at 30 Hz"
    return [*rows, *_losses(), Row("time of a measurement", f"{spent:.2f} s", "0.3 s", how)]
