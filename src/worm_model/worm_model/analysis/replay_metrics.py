# SPDX-License-Identifier: Apache-2.0
"""Agreement of the twin with a recording: residuals of x1, length and power for each run and cycle."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from worm_model.analysis.run_metrics import (
    END_TOLERANCE_NS,
    PlayedGait,
    played_gaits,
    root_mean_square,
)
from worm_model.arrays import Array
from worm_model.run import RUNNING, SAME_ONSET_NS, STOPPING, Run
from worm_model.simulation.quadrature import accumulated
from worm_model.twin.offline_replay import Replay, Series
from worm_model.twin.records import Event, Health

RESUMED_AFTER_NS = 500_000_000  # of a cycle's end, within which a live twin has stored its memory


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
    """Cycle of the gait.

    Attributes:
        number: in its run, from 1 on.
        start: s since the recording's first sample.
        grooves: grooves that the twin's rear anchor gained in it, along +x; NaN where the recording begins in it.
        measured_grooves: displacement of the rear module as the tracker saw it, in pitches.
        residuals: over the cycle.
        complete: whether the recording holds all of it.
        not_judged: why the twin did not judge it; empty where it did.
    """

    number: int
    start: float
    grooves: float
    measured_grooves: float
    residuals: Residuals
    complete: bool
    not_judged: str = ""


@dataclass(frozen=True)
class RunReport:
    """Run of a recording; ``health`` is the worst in it, ``events`` are at times in s since the first sample.

    ``not_judged`` says why nothing of it could be judged, and is empty otherwise.
    """

    played: PlayedGait
    onset: float
    cycles: tuple[CycleReport, ...]
    events: tuple[tuple[float, Event], ...]
    health: Health
    not_judged: str = ""


@dataclass(frozen=True)
class ReplayReport:
    """Recording: residuals from the last gait's onset on (of all samples, if there is no gait).

    `energy_error` is (measured − predicted) / measured at the last run's end; `cycles` are the last run's.
    """

    residuals: Residuals
    energy_error: float
    cycles: tuple[CycleReport, ...]
    runs: tuple[RunReport, ...]


def report_replay(run: Run, replay: Replay, pitch: float) -> ReplayReport:
    """Return the metrics of a replay; ``pitch`` of the grooves in m."""
    played = played_gaits(run.gait_state)
    ends = [*(p.onset for p in played[1:]), np.iinfo(np.int64).max][: len(played)]
    runs = tuple(
        _run_report(run, replay, pitch, p, end) for p, end in zip(played, ends, strict=True)
    )
    start = played[-1].onset if played else run.origin
    end = run_end(run, played[-1]) if played else _last(run)
    return ReplayReport(
        residuals=_residuals(replay.residuals, start, end + 1),
        energy_error=_energy_error(run, replay, start),
        cycles=runs[-1].cycles if runs else (),
        runs=runs,
    )


def _first(run: Run) -> int:
    """Return the stamp (ns) of the first sample of an instrument."""
    series = (run.commanded, run.measured, run.tracker, run.power)
    return int(min((s.stamp.min() for s in series if len(s.stamp)), default=run.origin))


def _last(run: Run) -> int:
    lasts = [s.stamp[-1] for s in (run.commanded, run.measured, run.tracker) if len(s.stamp)]
    return int(max(lasts, default=run.origin))


def run_end(run: Run, played: PlayedGait) -> int:
    """Return the stamp (ns) of a run's recorded end: the last requested cycle, or an earlier stop."""
    states, last = run.gait_state, _last(run)
    asked = played.cycle_window(1, played.cycles).end if played.cycles else last
    over = states.stamp[(states.stamp > played.onset) & ~np.isin(states.state, (RUNNING, STOPPING))]
    stopped = int(over.min(initial=last))
    if stopped + END_TOLERANCE_NS >= asked:  # told a little before or after it
        return min(asked, last)
    return min(max(stopped, played.onset), last)


def _run_report(
    run: Run, replay: Replay, pitch: float, played: PlayedGait, until: int
) -> RunReport:
    """Return the metrics of a run; the next one begins at ``until`` (ns)."""
    onset, end, period = played.onset, run_end(run, played), 1e9 * played.gait.period
    count = max(math.ceil((end - onset) / period - 1e-6), 0)
    recorded = min(max(math.floor((_first(run) - onset) / period), 0), count)
    borders = [onset + round(k * period) for k in range(count + 1)]
    unusable = replay.unusable.get(played.run or onset, "")
    stamp = replay.residuals["stamp_ns"]
    inside = (stamp >= onset) & (stamp <= end)
    health = replay.residuals["health"][inside]
    events = tuple(
        ((event.stamp_ns - run.origin) * 1e-9, event)
        for event in replay.notices
        if event.code and onset <= event.stamp_ns < until
    )
    return RunReport(
        played=played,
        onset=(onset - run.origin) * 1e-9,
        cycles=tuple(
            _cycle(run, replay, (onset, number), (borders[number - 1], borders[number]), pitch, end)
            for number in range(recorded + 1, count + 1)
        ),
        events=events,
        health=Health.UNKNOWN if unusable else Health(int(health.max(initial=0))),
        not_judged=unusable,
    )


def _residuals(series: Series, start: int, end: int) -> Residuals:
    inside = (series["stamp_ns"] >= start) & (series["stamp_ns"] < end)
    values = (series[name][inside] for name in ("rear_position", "length", "power"))
    return Residuals(*(judge(v) for v in values for judge in (_mean, root_mean_square)))


def _mean(values: Array) -> float:
    finite = values[np.isfinite(values)]
    return float(finite.mean()) if finite.size else math.nan


def _energy_error(run: Run, replay: Replay, start: int) -> float:
    """Return the twin's energy residual at the last power sample, relative to the measured energy."""
    series = replay.residuals
    known = np.flatnonzero(np.isfinite(series["energy"]))
    if not len(known):
        return math.nan
    last = known[-1]
    measured = _energy(run, start, int(series["stamp_ns"][last]))
    return float(series["energy"][last]) / measured if measured else math.nan


def _energy(run: Run, start: int, end: int) -> float:
    """Return the measured energy (J) between two stamps by trapezoids; the first sample counts from the start on."""
    power = run.power.valid_power
    inside = np.isfinite(power) & (run.power.stamp > start) & (run.power.stamp <= end)
    power, stamp = power[inside], run.power.stamp[inside]
    if not len(power):
        return math.nan
    time = np.concatenate([[0.0], (stamp - start) * 1e-9])
    values = np.concatenate([power[:1], power])
    return float(accumulated(time, values)[-1])


def _cycle(
    run: Run,
    replay: Replay,
    identity: tuple[int, int],
    span: tuple[int, int],
    pitch: float,
    end: int,
) -> CycleReport:
    """Return the metrics of a cycle over a span in ns; its run begins at an onset (ns) and ends at ``end``."""
    first, last = span
    cut_off = ""
    if first < _first(run):
        cut_off = "the recording begins in it"
    elif last > end:
        cut_off = "it was not played, or not recorded, to its end"
    said = (c.not_judged for c in replay.cycles if _is_close((c.onset_ns, c.number), identity))
    states = replay.states
    displacement = _at(run.tracker.stamp, run.tracker.rear_position, last) - _at(
        run.tracker.stamp, run.tracker.rear_position, first
    )
    return CycleReport(
        number=identity[1],
        start=(first - run.origin) * 1e-9,
        grooves=_grooves_at(states, last) - _grooves_at(states, first, replay.resumed_ns),
        measured_grooves=displacement / pitch,
        residuals=_residuals(replay.residuals, first, last),
        complete=not cut_off,
        not_judged=cut_off or next(said, ""),
    )


def _is_close(closed: tuple[int, int], identity: tuple[int, int]) -> bool:
    """Return True if an onset (ns) and a number belong to a cycle.

    A driver reports the onset once a cycle, converted between two clocks.
    """
    return closed[1] == identity[1] and abs(closed[0] - identity[0]) <= SAME_ONSET_NS


def _at(stamp: NDArray[np.int64], values: Array, when: int) -> float:
    """Return a signal at a stamp, linear between its samples; NaN without samples within 0.1 s."""
    known = np.isfinite(values)
    stamp, values = stamp[known], values[known]
    if not len(stamp) or np.min(np.abs(stamp - when)) > 10**8:
        return math.nan
    return float(np.interp(0.0, (stamp - when) * 1e-9, values))


def _grooves_at(states: Series, when: int, resumed: int = 0) -> float:
    """Return the rear groove of the twin's first state from a stamp on, when missed grooves are known.

    Just before the stamp at which a stored memory was ``resumed``, of the first state after that: others count from
    another groove. NaN without any state.
    """
    if 0 <= resumed - when <= RESUMED_AFTER_NS:
        when = resumed + 1
    rows = len(states["stamp_ns"])
    row = min(int(np.searchsorted(states["stamp_ns"], when)), rows - 1)
    return float(states["rear_groove"][row]) if rows else math.nan
