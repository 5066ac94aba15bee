# SPDX-License-Identifier: Apache-2.0
"""Gaits tuned by their measured margin, on robots of four kinds that the model does not contain."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from benchmarks.report import Row
from tests.helpers.foreign_robot import ForeignRobot, ForeignRun, crawl, some_robot
from worm_model.analysis.run_metrics import measure_margin
from worm_model.gait import Gait
from worm_model.margin.measured_margin import RunMargin
from worm_model.parameters import PAPER
from worm_model.run import seconds
from worm_optimizer.evaluation.task import MarginTask
from worm_optimizer.robustness.tuning import TuneState, Tuning, limits_of, next_gait

TITLE = "losses of grooves before and after tuning by the measured margin, runs, cost of transport (minutes)"
KINDS: Mapping[str, Mapping[str, float]] = {
    "usual": {},
    "stiff cable": {"cable_stiffness": 20000.0},
    "sticky": {"coulomb": 0.6, "breakaway": 1.0, "hysteresis_N": 0.6},
    "even pipe": {"pitch_scatter": 0.004},
}
ROBOTS = 10  # of each kind
FROM = (Gait(0.0713, 0.2), Gait(0.08, 0.3))  # the robust cruise of the optimizer, and a fast gait
PROBABILITY, GROOVES, CYCLES, COUNTED, MOST_RUNS = 0.99, 2, 5, 25, 5
G = 9.80665  # m/s²


def _lost(run: ForeignRun, gait: Gait) -> float:
    """Return the share of the cycles that lost a groove, without the first two."""
    return float((run.grooves(COUNTED, gait.frequency)[2:] < GROOVES).mean())


def _cost(robot: ForeignRobot, run: ForeignRun, gait: Gait) -> float:
    """Return the cost of transport of the cycles but the first two."""
    power = run.run.power
    time = seconds(power.stamp, int(run.run.gait_state.onset.max()))
    counted = (time > 2.0 * gait.period) & (time < COUNTED * gait.period)
    rear = np.interp([2.0 * gait.period, COUNTED * gait.period], run.time, run.rear)
    speed = float(np.diff(rear)[0]) / ((COUNTED - 2) * gait.period)
    return float(power.power[counted].mean()) / (2.0 * robot.mass * G * speed)


def _tune(robot: ForeignRobot, gait: Gait) -> tuple[Tuning | None, Gait, int]:
    """Return the last step of a tuning, the gait that it leaves, and the number of runs."""
    runs: list[RunMargin] = []
    limits = limits_of(MarginTask())
    step = None
    for number in range(1, MOST_RUNS + 1):
        found = measure_margin(crawl(robot, gait, CYCLES, seed=number).run, PAPER, GROOVES)
        runs.append(found)
        step = next_gait(runs, PROBABILITY, limits, PAPER)
        if step is None:
            break
        if number < MOST_RUNS or step.state is not TuneState.RUN:
            gait = step.gait
        if step.state is not TuneState.RUN:
            break
    return step, gait, number


def _best_cost(robot: ForeignRobot, frequency: float) -> float:
    """Return the cost of transport of the smallest stroke that keeps all grooves at a frequency, NaN without any."""
    for stroke in np.arange(0.06, 0.09, 0.0005):
        gait = Gait(float(stroke), frequency)
        run = crawl(robot, gait, COUNTED)
        if not _lost(run, gait):
            return _cost(robot, run, gait)
    return math.nan


def _row(kind: str, first: Gait) -> Row:
    before, after, count, cost, done = [], [], [], [], 0
    for seed in range(ROBOTS):
        robot = some_robot(seed, **KINDS[kind])
        before.append(_lost(crawl(robot, first, COUNTED), first))
        step, gait, runs = _tune(robot, first)
        done += step is not None and step.state is TuneState.DONE
        run = crawl(robot, gait, COUNTED)
        after.append(_lost(run, gait))
        count.append(runs)
        cost.append(_cost(robot, run, gait) / _best_cost(robot, gait.frequency) - 1.0)
    return Row(
        f"{kind}, from {1e3 * first.stroke:g} mm at {first.frequency:g} Hz",
        f"{np.mean(before):.1%} lost before, {np.mean(after):.2%} after {np.mean(count):.1f} runs, "
        f"cost {np.nanmean(cost):+.1%}, done {done} of {ROBOTS}",
        "0.5 % after 3 runs, +4 %",
        f"{ROBOTS} robots, {COUNTED - 2} cycles each; cost against the smallest stroke without a loss",
    )


def run() -> list[Row]:
    """Measure."""
    return [_row(kind, first) for first in FROM for kind in KINDS]
