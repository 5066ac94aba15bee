# SPDX-License-Identifier: Apache-2.0
"""How well the twin follows a run: residuals of x1, length and power, over the gait and cycle by cycle."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from worm_model.analysis.run_metrics import root_mean_square
from worm_model.run import RUNNING, Run
from worm_model.simulation.quadrature import accumulated
from worm_model.twin.offline_replay import Replay, Series

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Residuals:
    """Measured minus predicted over a span: means and root mean squares; NaN without samples.

    x1 in m; length (measured minus estimated from the command) in m; power in W.
    """

    x1_residual: float
    x1_rmse: float
    length_residual: float
    length_rmse: float
    power_residual: float
    power_rmse: float


@dataclass(frozen=True)
class CycleReport:
    """One cycle of the gait.

    Attributes:
        start: s since the run's first sample.
        grooves: grooves that the twin's rear anchor gained in it, along +x.
        measured_grooves: displacement of the rear module as the tracker saw it, in pitches.
        residuals: over the cycle.
        complete: whether the recording holds all of it.
    """

    start: float
    grooves: float
    measured_grooves: float
    residuals: Residuals
    complete: bool


@dataclass(frozen=True)
class ReplayReport:
    """A whole run: residuals from the gait's onset on (of everything, where no gait was recorded).

    `energy_error` is (measured − predicted) / measured at the run's end.
    """

    residuals: Residuals
    energy_error: float
    cycles: tuple[CycleReport, ...]


def report_replay(run: Run, replay: Replay, pitch: float) -> ReplayReport:
    """Judge a replay; `pitch` of the grooves in m."""
    onset, period = _gait(run)
    end = _end(run)
    start = run.origin if onset is None else onset
    cycles: tuple[CycleReport, ...] = ()
    if onset is not None:
        count = max(math.ceil((end - onset) / period - 1e-6), 0)
        borders = [onset + round(k * period) for k in range(count + 1)]
        cycles = tuple(
            _cycle(run, replay, (first, last), pitch, end) for first, last in pairwise(borders)
        )
    return ReplayReport(
        residuals=_residuals(replay.residuals, start, end + 1),
        energy_error=_energy_error(run, replay, start),
        cycles=cycles,
    )


def _gait(run: Run) -> tuple[int | None, float]:
    """Onset (ns) and period (ns) of the last gait that ran."""
    states = run.gait_state
    running = np.flatnonzero(states.played)
    if not len(running):
        return None, math.nan
    last = running[-1]
    return int(states.onset[last]), 1e9 / float(states.frequency[last])


def _end(run: Run) -> int:
    """Stamp (ns) at which the gait was over, as far as it was recorded."""
    states = run.gait_state
    last = max(
        (int(s.stamp[-1]) for s in (run.commanded, run.measured, run.tracker) if len(s.stamp)),
        default=run.origin,
    )
    running = np.flatnonzero(states.state == RUNNING)
    if not len(running):
        return last
    row = running[-1]
    asked = int(states.onset[row]) + round(states.cycles[row] * 1e9 / states.frequency[row])
    return min(last, asked) if states.cycles[row] else last


def _residuals(series: Series, start: int, end: int) -> Residuals:
    inside = (series["stamp_ns"] >= start) & (series["stamp_ns"] < end)
    x1, length, power = (series[name][inside] for name in ("rear_position", "length", "power"))
    return Residuals(
        x1_residual=_mean(x1),
        x1_rmse=root_mean_square(x1),
        length_residual=_mean(length),
        length_rmse=root_mean_square(length),
        power_residual=_mean(power),
        power_rmse=root_mean_square(power),
    )


def _mean(values: Array) -> float:
    finite = values[np.isfinite(values)]
    return float(finite.mean()) if finite.size else math.nan


def _energy_error(run: Run, replay: Replay, start: int) -> float:
    """The twin's own energy residual at the last power sample, over the energy measured until then."""
    series = replay.residuals
    known = np.flatnonzero(np.isfinite(series["energy"]))
    if not len(known):
        return math.nan
    last = known[-1]
    measured = _energy(run, start, int(series["stamp_ns"][last]))
    return float(series["energy"][last]) / measured if measured else math.nan


def _energy(run: Run, start: int, end: int) -> float:
    """Measured energy (J) between two stamps by trapezoids, the first sample counting from the start on."""
    power = run.power.valid_power
    inside = np.isfinite(power) & (run.power.stamp > start) & (run.power.stamp <= end)
    power, stamp = power[inside], run.power.stamp[inside]
    if not len(power):
        return math.nan
    time = np.concatenate([[0.0], (stamp - start) * 1e-9])
    values = np.concatenate([power[:1], power])
    return float(accumulated(time, values)[-1])


def _cycle(run: Run, replay: Replay, span: tuple[int, int], pitch: float, end: int) -> CycleReport:
    first, last = span
    states = replay.states
    displacement = _at(run.tracker.stamp, run.tracker.rear_position, last) - _at(
        run.tracker.stamp, run.tracker.rear_position, first
    )
    gained = _step_at(states, last) - _step_at(states, first)
    return CycleReport(
        start=(first - run.origin) * 1e-9,
        grooves=gained,
        measured_grooves=displacement / pitch,
        residuals=_residuals(replay.residuals, first, last),
        complete=last <= end,
    )


def _at(stamp: NDArray[np.int64], values: Array, when: int) -> float:
    """A signal at a stamp: linear between its samples, NaN where there are none within 0.1 s."""
    known = np.isfinite(values)
    stamp, values = stamp[known], values[known]
    if not len(stamp) or np.min(np.abs(stamp - when)) > 10**8:
        return math.nan
    return float(np.interp(0.0, (stamp - when) * 1e-9, values))


def _step_at(states: Series, when: int) -> float:
    """Rear groove of the twin at a stamp, as of the last state before."""
    row = int(np.searchsorted(states["stamp_ns"], when, side="right")) - 1
    return float(states["rear_groove"][row]) if row >= 0 else 0.0
