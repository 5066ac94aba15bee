# SPDX-License-Identifier: Apache-2.0
"""Residuals of the twin over a recording: x1, length and power, for each run and each cycle."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from worm_model.analysis.run_metrics import (
    END_TOLERANCE_NS,
    PlayedGait,
    played_gaits,
    root_mean_square,
)
from worm_model.arrays import accumulated
from worm_model.run import PLAYING, SAME_ONSET_NS, GaitStates, Run
from worm_model.twin.data.records import Event, Health
from worm_model.twin.data.samples import NO_SAMPLES, SampleKind, SampleRows
from worm_model.twin.offline_replay import Replay, Series
from worm_model.twin.recorded_samples import RecordedSamples
from worm_model.twin.twin import ClosedCycle, Output

#: the position at a stamp is interpolated from the samples whose stamps differ from it by at most this
NEAR_NS = 1_000_000_000
_FOREVER = int(np.iinfo(np.int64).max)
_CHANNELS = ("rear_position", "length", "power")


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
        complete: True if the recording contains the whole cycle.
        not_judged: reason why the twin did not judge the cycle; empty if it did.
        residuals: residuals over the cycle.
    """

    number: int
    start: float
    grooves: float
    measured_grooves: float
    complete: bool
    not_judged: str
    residuals: Residuals


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


class ReplayReporter:
    """Builder of the report on a replay, whose samples and output are added in parts.

    Args:
        samples: the recording.
        pitch: pitch of the grooves, m.

    Attributes:
        events: events of the twin so far.
    """

    def __init__(self, samples: RecordedSamples, pitch: float) -> None:
        self._samples, self._pitch = samples, pitch
        self.events: list[Event] = []
        self._closed: list[ClosedCycle] = []
        self._states = _Columns("stamp_ns", "rear_groove")
        self._residuals = _Columns("stamp_ns", *_CHANNELS, "energy", "health")
        self._positions, self._power = _Columns("stamp", "a"), _Columns("stamp", "a")

    def add(self, rows: SampleRows, output: Output) -> None:
        """Add samples (rows of SAMPLE) and the output of the twin for these samples."""
        self.events += output.events
        self._closed += output.cycles
        self._states.add(output.motion)
        self._residuals.add(output.residuals)
        for columns, kind in (
            (self._positions, SampleKind.POSITION),
            (self._power, SampleKind.POWER),
        ):
            columns.add(rows[(rows["kind"] == kind) & np.isfinite(rows["a"])])

    def report(self, unusable: Mapping[int, str]) -> ReplayReport:
        """Return the report on all that has been added.

        Args:
            unusable: reasons why runs cannot be judged, see `Replay.unusable`.
        """
        samples, residuals = self._samples, self._residuals.whole()
        order = np.argsort(residuals["stamp_ns"], kind="stable")  # The clock may have gone back.
        by_stamp = {name: column[order] for name, column in residuals.items()}
        last = samples.origin if samples.last_ns is None else samples.last_ns
        played = played_gaits(samples.gait_state)
        ends = [_end_of_run(samples.gait_state, last, each) for each in played]
        untils = [*(each.onset for each in played[1:]), _FOREVER]
        runs = tuple(
            self._run_report(each, end, until, by_stamp, unusable)
            for each, end, until in zip(played, ends, untils, strict=False)
        )
        start, end = (played[-1].onset, ends[-1]) if played else (samples.origin, last)
        return ReplayReport(
            residuals=_residuals(by_stamp, start, end + 1),
            energy_error=_energy_error(self._power.whole(), residuals, start),
            cycles=runs[-1].cycles if runs else (),
            runs=runs,
        )

    def _run_report(
        self,
        played: PlayedGait,
        end: int,
        until: int,
        residuals: Series,
        unusable: Mapping[int, str],
    ) -> RunReport:
        """Return the report on a run that ended at ``end``; the next run begins at ``until`` (ns)."""
        origin, onset = self._samples.origin, played.onset
        first = origin if self._samples.first_ns is None else self._samples.first_ns
        period = 1e9 * played.gait.period
        count = max(math.ceil((end - onset) / period - 1e-6), 0)
        missed = min(max(math.floor((first - onset) / period), 0), count)  # before the recording
        borders = [onset + round(k * period) for k in range(missed, count + 1)]
        grooves, x1 = self._grooves_at(borders), self._positions_at(borders)
        reasons = {
            cycle.number: cycle.not_judged
            for cycle in reversed(self._closed)
            if abs(cycle.onset_ns - onset) <= SAME_ONSET_NS
        }
        cycles = []
        for k, (begin, over) in enumerate(pairwise(borders)):
            cut_off = ""
            if begin < first:
                cut_off = "the recording begins within the cycle"
            elif over > end:
                cut_off = "the cycle was not played, or not recorded, to its end"
            number = missed + 1 + k
            cycles.append(
                CycleReport(
                    number=number,
                    start=(begin - origin) * 1e-9,
                    grooves=grooves[k + 1] - grooves[k],
                    measured_grooves=(x1[k + 1] - x1[k]) / self._pitch,
                    complete=not cut_off,
                    not_judged=cut_off or reasons.get(number, ""),
                    residuals=_residuals(residuals, begin, over),
                )
            )
        inside = (residuals["stamp_ns"] >= onset) & (residuals["stamp_ns"] <= end)
        reason = unusable.get(played.run or onset, "")
        return RunReport(
            played=played,
            onset=(onset - origin) * 1e-9,
            cycles=tuple(cycles),
            events=tuple(
                ((event.stamp_ns - origin) * 1e-9, event)
                for event in self.events
                if event.code and onset <= event.stamp_ns < until
            ),
            health=Health.UNKNOWN
            if reason
            else Health(int(residuals["health"][inside].max(initial=0))),
            not_judged=reason,
        )

    def _positions_at(self, stamps: Sequence[int]) -> list[float]:
        """Return the tracker's x1 (m) at stamps, linear between samples; NaN if no sample is within 0.1 s."""
        positions = self._positions.whole()
        found = []
        for when in stamps:
            near = np.abs(positions["stamp"] - when) <= NEAR_NS
            offset, values = positions["stamp"][near] - when, positions["a"][near]
            known = len(offset) and np.min(np.abs(offset)) <= 10**8
            found.append(float(np.interp(0.0, offset * 1e-9, values)) if known else math.nan)
        return found

    def _grooves_at(self, stamps: Sequence[int]) -> list[float]:
        """Return the twin's rear groove in the first state from each stamp (ns) on, or else in the last state.

        The groove includes the twin's corrections for missed and gained grooves. The result is NaN without any state.
        """
        states = self._states.whole()
        if not len(states["stamp_ns"]):
            return [math.nan] * len(stamps)
        rows = np.searchsorted(states["stamp_ns"], stamps)
        found: list[float] = states["rear_groove"].take(rows, mode="clip").astype(float).tolist()
        return found


class _Columns:
    """Columns of a series whose rows are added in parts."""

    def __init__(self, *names: str) -> None:
        self._parts: dict[str, list[NDArray[Any]]] = {name: [] for name in names}

    def add(self, series: Any) -> None:
        """Add the rows of a series, which may have further columns."""
        for name, parts in self._parts.items():
            parts.append(series[name].copy())  # not a view of the further columns

    def whole(self) -> Series:
        """Return the columns of all rows."""
        return {name: np.concatenate(parts) for name, parts in self._parts.items()}


def _residuals(series: Series, start: int, end: int) -> Residuals:
    """Return means and root mean squares of residuals, by ascending stamp, from ``start`` (ns) to before ``end``."""
    rows = slice(*np.searchsorted(series["stamp_ns"], (start, end)))
    figures = []
    for name in _CHANNELS:
        values = series[name][rows]
        finite = values[np.isfinite(values)]
        figures += [float(finite.mean()) if finite.size else math.nan, root_mean_square(values)]
    return Residuals(*figures)


def _energy_error(power: Series, residuals: Series, start: int) -> float:
    """Return the last energy residual, divided by the energy measured since ``start`` (ns); NaN if one is unknown.

    Until the first power sample, the power is assumed to have the value of this sample.
    """
    known = np.flatnonzero(np.isfinite(residuals["energy"]))
    if not known.size:
        return math.nan
    last = residuals["stamp_ns"][known[-1]]
    rows = np.flatnonzero((power["stamp"] > start) & (power["stamp"] <= last))
    if not rows.size:
        return math.nan
    time = np.append(0.0, (power["stamp"][rows] - start) * 1e-9)
    energy = float(accumulated(time, power["a"][[rows[0], *rows]])[-1])
    return float(residuals["energy"][known[-1]]) / energy if energy else math.nan


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
