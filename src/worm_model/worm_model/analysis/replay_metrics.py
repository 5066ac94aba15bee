# SPDX-License-Identifier: Apache-2.0
"""Residuals of the twin over a recording: x1, length and power, for each run and each cycle."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from worm_model.analysis.run_metrics import END_TOLERANCE_NS, PlayedGait, played_gaits
from worm_model.arrays import Array, Stamps, accumulated
from worm_model.run import PLAYING, SAME_ONSET_NS, GaitStates, Run
from worm_model.twin.data.records import Event, Health
from worm_model.twin.data.samples import NO_SAMPLES, SampleKind, SampleRows
from worm_model.twin.offline_replay import Replay, Series
from worm_model.twin.recorded_samples import RecordedSamples
from worm_model.twin.twin import ClosedCycle, Output

#: time after the end of a cycle by which all samples of the cycle have been processed
SETTLED_NS = 2_000_000_000
#: the position at a stamp is interpolated from the samples whose stamps differ from it by at most this
NEAR_NS = 1_000_000_000
_FOREVER = int(np.iinfo(np.int64).max)
_RESIDUALS = ("rear_position", "length", "power")


@dataclass(frozen=True)
class Residuals:
    """Means (``_residual``) and root mean squares (``_rmse``) of the residuals over a span; NaN without samples.

    Residuals are measured minus predicted: x1 in m, power in W, and the length in m. The predicted length is the one
    that is estimated from the command.
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
        number: number of the cycle in its run, from 1.
        start: start of the cycle, s since the recording's first sample.
        grooves: grooves that the twin's rear anchor gained in the cycle, along +x; NaN without a state of the twin.
        measured_grooves: displacement of the rear module according to the tracker, in pitches.
        residuals: residuals over the cycle.
        complete: True if the recording contains the whole cycle.
        not_judged: reason why the twin did not judge the cycle; empty if it did.
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
    """One run of a recording.

    Attributes:
        played: gait of the run.
        onset: start of the first cycle, s since the recording's first sample.
        cycles: cycles of the run that the recording contains, at least in part.
        events: events with a code, each as (time in s since the recording's first sample, event).
        health: worst health during the run.
        not_judged: reason why the run could not be judged; empty if it was.
    """

    played: PlayedGait
    onset: float
    cycles: tuple[CycleReport, ...]
    events: tuple[tuple[float, Event], ...]
    health: Health
    not_judged: str = ""


@dataclass(frozen=True)
class ReplayReport:
    """Report on a recording: residuals over the last run, or over the whole recording if it contains no gait.

    `energy_error` is (measured − predicted) / measured energy at the last energy residual, since the start of the last
    run or, without a gait, of the recording. `cycles` are the cycles of the last run.
    """

    residuals: Residuals
    energy_error: float
    cycles: tuple[CycleReport, ...]
    runs: tuple[RunReport, ...]


def report_replay(run: Run, replay: Replay, pitch: float) -> ReplayReport:
    """Return the report on the replay of a run; ``pitch`` is that of the grooves, m."""
    samples = RecordedSamples(lambda: (run,))
    reporter = ReplayReporter(samples, pitch)
    rows = np.concatenate([NO_SAMPLES, *samples.rows()])
    states: Any = replay.states
    residuals: Any = replay.residuals
    lengths: Any = replay.lengths
    reporter.add(rows, Output(states, residuals, lengths, replay.notices, {}, replay.cycles))
    return reporter.report(replay.unusable)


@dataclass
class _CycleData:
    """Cycle of a run: its start and end (ns), and its metrics, which are unknown until the cycle is closed."""

    start: int
    end: int
    grooves: float = math.nan
    measured_grooves: float = math.nan
    residuals: Residuals | None = None


@dataclass
class _RunData:
    """Run with its end and the onset ``until`` of the next run (ns), its cycles, and its worst health so far.

    ``first_cycle`` is the number of the first cycle in ``cycles``.
    """

    played: PlayedGait
    end: int
    until: int
    first_cycle: int
    cycles: list[_CycleData]
    health: int = 0


class ReplayReporter:
    """Builder of the report on a replay, whose samples and output are added in parts.

    Only the samples of unfinished cycles are in memory, unless the clock went back.

    Args:
        samples: the recording.
        pitch: pitch of the grooves, m.

    Attributes:
        events: events of the twin so far.
    """

    def __init__(self, samples: RecordedSamples, pitch: float) -> None:
        self._samples, self._pitch = samples, pitch
        self.events: list[Event] = []
        self._closed: dict[int, list[ClosedCycle]] = {}
        last = samples.origin if samples.last_ns is None else samples.last_ns
        played = played_gaits(samples.gait_state)
        untils = [*(p.onset for p in played[1:]), _FOREVER][: len(played)]
        self._runs = [
            self._run(p, _end_of_run(samples.gait_state, last, p), until)
            for p, until in zip(played, untils, strict=True)
        ]
        cycles = (cycle for run in self._runs for cycle in run.cycles)
        self._open = deque(sorted(cycles, key=lambda cycle: (cycle.end, cycle.start)))
        self._starts = np.array([c.start for c in self._open], np.int64)
        self._starts = np.minimum.accumulate(self._starts[::-1])[::-1]
        self._span = (played[-1].onset, self._runs[-1].end) if played else (samples.origin, last)
        self._total = _ResidualSums()
        self._energy = _Energy(self._span[0])
        self._states: Series = {}
        self._residuals: Series = {}
        self._positions: Series = {}

    def add(self, rows: SampleRows, output: Output) -> None:
        """Add samples (rows of SAMPLE) and the output of the twin for these samples."""
        self.events += output.events
        for closed in output.cycles:
            self._closed.setdefault(closed.number, []).append(closed)
        residuals = output.residuals
        stamp, health = residuals["stamp_ns"], residuals["health"]
        for run in self._runs if len(stamp) else ():
            if run.played.onset <= stamp.max() and stamp.min() <= run.end:
                inside = (stamp >= run.played.onset) & (stamp <= run.end)
                run.health = max(run.health, int(health[inside].max(initial=0)))
        self._total.add(residuals, self._span[0], self._span[1] + 1)
        power = rows[rows["kind"] == SampleKind.POWER]
        self._energy.add(power["stamp"], power["a"], stamp, residuals["energy"])
        position = rows[(rows["kind"] == SampleKind.POSITION) & np.isfinite(rows["a"])]
        self._states = _appended(self._states, output.states, ("stamp_ns", "rear_groove"))
        self._residuals = _appended(self._residuals, residuals, ("stamp_ns", *_RESIDUALS))
        self._positions = _appended(self._positions, position, ("stamp", "a"))
        # If the clock went back, later samples may belong to earlier cycles.
        if not self._samples.clock_went_back:
            self._close(int(self._states["stamp_ns"].max(initial=0)) - SETTLED_NS)

    def report(self, unusable: Mapping[int, str]) -> ReplayReport:
        """Return the report on all that has been added.

        Args:
            unusable: reasons why runs cannot be judged, see `Replay.unusable`.
        """
        self._close(_FOREVER)
        runs = tuple(self._run_report(run, unusable) for run in self._runs)
        return ReplayReport(
            residuals=self._total.residuals(),
            energy_error=self._energy.error(),
            cycles=runs[-1].cycles if runs else (),
            runs=runs,
        )

    def _run(self, played: PlayedGait, end: int, until: int) -> _RunData:
        onset, period = played.onset, 1e9 * played.gait.period
        count = max(math.ceil((end - onset) / period - 1e-6), 0)
        recorded = min(max(math.floor((self._first - onset) / period), 0), count)
        borders = [onset + round(k * period) for k in range(recorded, count + 1)]
        cycles = [_CycleData(*span) for span in pairwise(borders)]
        return _RunData(played, end, until, recorded + 1, cycles)

    @property
    def _first(self) -> int:
        """Stamp (ns) of the first sample of an instrument."""
        first = self._samples.first_ns
        return self._samples.origin if first is None else first

    def _close(self, until: int) -> None:
        """Compute the metrics of the cycles that end before a stamp (ns), and discard their samples."""
        count = 0
        while self._open and self._open[0].end < until:
            cycle, count = self._open.popleft(), count + 1
            displacement = self._position_at(cycle.end) - self._position_at(cycle.start)
            cycle.measured_grooves = displacement / self._pitch
            cycle.grooves = self._groove_at(cycle.end) - self._groove_at(cycle.start)
            sums = _ResidualSums()
            sums.add(self._residuals, cycle.start, cycle.end)
            cycle.residuals = sums.residuals()
        self._starts = self._starts[count:]
        begin = (int(self._starts[0]) if len(self._starts) else _FOREVER) - NEAR_NS
        self._states = _since(self._states, "stamp_ns", begin)
        self._residuals = _since(self._residuals, "stamp_ns", begin)
        self._positions = _since(self._positions, "stamp", begin)

    def _position_at(self, when: int) -> float:
        """Return the tracker's x1 (m) at a stamp, linear between samples; NaN if no sample is within 0.1 s of it."""
        stamp = self._positions["stamp"]
        near = np.abs(stamp - when) <= NEAR_NS
        stamp, values = stamp[near], self._positions["a"][near]
        if not len(stamp) or np.min(np.abs(stamp - when)) > 10**8:
            return math.nan
        return float(np.interp(0.0, (stamp - when) * 1e-9, values))

    def _groove_at(self, when: int) -> float:
        """Return the twin's rear groove in the first state from a stamp (ns) on, or else in the last state.

        The groove includes the twin's corrections for missed and gained grooves. The result is NaN without any state.
        """
        rows = len(self._states["stamp_ns"])
        row = min(int(np.searchsorted(self._states["stamp_ns"], when)), rows - 1)
        return float(self._states["rear_groove"][row]) if rows else math.nan

    def _run_report(self, run: _RunData, unusable: Mapping[int, str]) -> RunReport:
        origin, onset = self._samples.origin, run.played.onset
        reason = unusable.get(run.played.run or onset, "")
        return RunReport(
            played=run.played,
            onset=(onset - origin) * 1e-9,
            cycles=tuple(
                self._cycle_report(run, number, cycle)
                for number, cycle in enumerate(run.cycles, run.first_cycle)
            ),
            events=tuple(
                ((event.stamp_ns - origin) * 1e-9, event)
                for event in self.events
                if event.code and onset <= event.stamp_ns < run.until
            ),
            health=Health.UNKNOWN if reason else Health(run.health),
            not_judged=reason,
        )

    def _cycle_report(self, run: _RunData, number: int, cycle: _CycleData) -> CycleReport:
        cut_off = ""
        if cycle.start < self._first:
            cut_off = "the recording begins within the cycle"
        elif cycle.end > run.end:
            cut_off = "the cycle was not played, or not recorded, to its end"
        reasons = (
            closed.not_judged
            for closed in self._closed.get(number, ())
            if abs(closed.onset_ns - run.played.onset) <= SAME_ONSET_NS
        )
        assert cycle.residuals is not None
        return CycleReport(
            number=number,
            start=(cycle.start - self._samples.origin) * 1e-9,
            grooves=cycle.grooves,
            measured_grooves=cycle.measured_grooves,
            residuals=cycle.residuals,
            complete=not cut_off,
            not_judged=cut_off or next(reasons, ""),
        )


class _ResidualSums:
    """Sums of the finite residuals and of their squares, and their number, for each channel."""

    def __init__(self) -> None:
        self._sums = np.zeros((3, len(_RESIDUALS)))

    def add(self, series: Any, start: int, end: int) -> None:
        """Add the residuals with stamps from ``start`` (ns) to before ``end``; ``series`` has columns by name."""
        inside = (series["stamp_ns"] >= start) & (series["stamp_ns"] < end)
        for channel, name in enumerate(_RESIDUALS):
            values = series[name][inside]
            values = values[np.isfinite(values)]
            self._sums[:, channel] += values.sum(), np.square(values).sum(), values.size

    def residuals(self) -> Residuals:
        """Return means and root mean squares of the residuals added so far; NaN for a channel without residuals."""
        total, square, count = np.where(self._sums[2] > 0, self._sums, math.nan)
        columns = zip((total / count).tolist(), np.sqrt(square / count).tolist(), strict=True)
        return Residuals(*(value for column in columns for value in column))


class _Energy:
    """Energy error at the last energy residual. The measured energy (J) is integrated by the trapezoidal rule.

    Args:
        start: stamp at which the integral begins, ns. Until the first power sample, the power is assumed to have the
            value of this sample.
    """

    def __init__(self, start: int) -> None:
        self._stamp, self._power = np.array([start]), np.zeros(1)
        self._is_measured = False
        self._measured = 0.0
        self._residual = math.nan

    def add(self, stamp: Stamps, power: Array, known_at: Stamps, residual: Array) -> None:
        """Add power (W) at stamps (ns), and residuals of the energy (J, NaN: unknown) at other stamps (ns)."""
        inside = np.isfinite(power) & (stamp > self._stamp[0])
        if not self._is_measured and inside.any():
            self._power[:] = power[inside][0]
            self._is_measured = True
        self._stamp = np.append(self._stamp, stamp[inside])
        self._power = np.append(self._power, power[inside])
        known = np.flatnonzero(np.isfinite(residual))
        if not len(known):
            return
        self._residual = float(residual[known[-1]])
        done = np.flatnonzero(self._stamp <= known_at[known[-1]])
        if len(done):
            time = (self._stamp[done] - self._stamp[0]) * 1e-9
            self._measured += float(accumulated(time, self._power[done])[-1])
            self._stamp, self._power = self._stamp[done[-1] :], self._power[done[-1] :]

    def error(self) -> float:
        """Return the last energy residual divided by the measured energy; NaN if one of them is unknown."""
        return self._residual / self._measured if self._measured else math.nan


def _appended(series: Series, more: Any, names: tuple[str, ...]) -> Series:
    """Return the columns ``names`` of a series, followed by those of ``more``; an empty series has no columns."""
    return {n: np.append(series[n], more[n]) if series else more[n].copy() for n in names}


def _since(series: Series, stamps: str, begin: int) -> Series:
    """Return the rows of a series from the stamp ``begin`` (ns) on, and at least the last row.

    ``stamps`` is the name of the column with the stamps.
    """
    if not series or not len(series[stamps]) or series[stamps][0] >= begin:
        return series
    kept = series[stamps] >= begin
    kept[-1] = True
    return {name: column[kept] for name, column in series.items()}


def run_end(run: Run, played: PlayedGait) -> int:
    """Return the stamp (ns) at which a run ends: after its last cycle, or earlier at a stop or the recording's end."""
    lasts = [s.stamp[-1] for s in (run.commanded, run.measured, run.tracker) if len(s.stamp)]
    return _end_of_run(run.gait_state, int(max(lasts, default=run.origin)), played)


def _end_of_run(states: GaitStates, last: int, played: PlayedGait) -> int:
    """Return the end of a run (ns); ``last`` is the last stamp of the recording."""
    requested = played.cycle_window(1, played.cycles).end if played.cycles else last
    over = states.stamp[(states.stamp > played.onset) & ~np.isin(states.state, PLAYING)]
    stopped = int(over.min(initial=last))
    if stopped + END_TOLERANCE_NS >= requested:  # the two stamps come from different clocks
        return min(requested, last)
    return min(max(stopped, played.onset), last)
