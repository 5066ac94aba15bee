# SPDX-License-Identifier: Apache-2.0
"""Recorded gait with all values of a report: measured, expected, and predicted by the twin."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from worm_model.analysis import run_metrics
from worm_model.analysis.replay_metrics import ReplayReport, report_replay
from worm_model.errors import RecordingError
from worm_model.gait import Gait
from worm_model.margin.measured_margin import RunMargin
from worm_model.margin.predicted_margin import predicted_margin
from worm_model.parameters import ParameterFile, Parameters
from worm_model.run import Run
from worm_model.simulation.simulator import cost_of_transport
from worm_model.twin.offline_replay import Replay
from worm_optimizer.report.events import Event
from worm_optimizer.report.expectation import Band, Bands, Expectation, expect


@dataclass(frozen=True)
class RecordedGait:
    """One gait of a recording.

    Attributes:
        name: name of the gait.
        run: part of the recording, from the rest before this gait to the rest before the next one. The parts of the
            first and the last gait extend to the ends of the recording.
        played: gait as the driver reported it.
        averaged_cycles: first and last averaged cycle, counted from 1. They are the last complete cycles that were
            played and recorded, at most three; (1, 1) if there is no such cycle.
        content: parameters used for the prediction and the twin.
        parameter_source: origin of these parameters.
        replay: output of the twin for the part.
        judged: metrics of the replay.
        measured: mean of the averaged cycles, with the lowest and highest cycle as bounds.
        twin: the same means and bounds according to the twin, which is driven by the recorded lengths.
        expected: prediction for the averaged cycles, from the command alone.
        idle_power: power measured at rest, W.
        margin: measured margins.
        predicted_margin: margin that the model predicts at the groove phase of the run, m; NaN without a measured one.
        events: events of the part.
        early_end: remark on a gait that ended early or in FAULT, or was not recorded completely; otherwise
            empty.
        missing: reasons for measured values that are NaN.
        provenance: origin of the recording, by name.
    """

    name: str
    run: Run
    played: run_metrics.PlayedGait
    averaged_cycles: tuple[int, int]
    content: ParameterFile
    parameter_source: str
    replay: Replay
    judged: ReplayReport
    measured: Bands
    twin: Bands
    expected: Expectation
    idle_power: float
    margin: RunMargin
    predicted_margin: float
    events: tuple[Event, ...]
    early_end: str
    missing: tuple[str, ...]
    provenance: dict[str, str]

    @property
    def gait(self) -> Gait:
        """Gait that was played."""
        return self.played.gait

    @property
    def is_steady(self) -> bool:
        """True if three cycles are averaged without the first one, which begins with straight fins."""
        first, last = self.averaged_cycles
        return first > 1 and last - first + 1 == run_metrics.AVERAGED_CYCLES

    @property
    def window(self) -> run_metrics.Window:
        """Window of the averaged cycles."""
        return self.played.cycle_window(*self.averaged_cycles)


def recorded_gait(
    run: Run,
    name: str,
    replay: Replay,
    parameters: tuple[ParameterFile, str],
    events: tuple[Event, ...],
    provenance: dict[str, str],
) -> RecordedGait:
    """Compute the metrics of one gait from its part of a recording and of the twin's replay, and predict the gait.

    Args:
        run: part of the recording.
        name: name of the gait.
        replay: output of the twin for the part.
        parameters: content of the parameter file and its origin.
        events: events of the part.
        provenance: origin of the recording.
    """
    content, source = parameters
    try:
        played = run_metrics.last_played_gait(run.gait_state)
    except RecordingError as error:
        raise RecordingError(f"{name}: {error}") from None
    averaged = run_metrics.averaged_cycles(run, played)
    window = played.cycle_window(*averaged)
    spans = [window, *run_metrics.single_cycles(window, averaged[1] - averaged[0] + 1)]
    missing: list[str] = []
    mass, direction = content.parameters.mass, played.gait.direction
    states = replay.states
    followed = (states["stamp_ns"], states["rear_position"])
    energy = run_metrics.accumulated_energy((run.power.stamp, run.power.valid_power))
    tracked = (run.tracker.stamp, run.tracker.rear_position)
    if run_metrics.completed_cycles(run, played):
        measured = _bands(tracked, energy, spans, direction, mass, missing)
    else:
        measured = Bands(*(Band(math.nan, math.nan, math.nan) for _ in range(3)))
        missing.append("no cycle was completed: speed, power and cost of transport are unavailable")
    margin = run_metrics.measure_margin(run, content.parameters)
    grooves = measured.speed.value / (played.gait.frequency * content.parameters.pitch)
    return RecordedGait(
        name=name,
        run=run,
        played=played,
        averaged_cycles=averaged,
        content=content,
        parameter_source=source,
        replay=replay,
        judged=report_replay(run, replay, content.parameters.pitch),
        measured=measured,
        twin=_bands(followed, (states["stamp_ns"], states["energy"]), spans, direction, mass, []),
        expected=expect(played.gait, content, averaged, grooves),
        idle_power=run_metrics.idle_power(run, played),
        margin=margin,
        predicted_margin=_predicted_margin(margin, content.parameters, replay, played),
        events=events,
        early_end=_early_end(run, played, events),
        missing=tuple(missing),
        provenance=provenance,
    )


def _predicted_margin(
    margin: RunMargin, parameters: Parameters, replay: Replay, played: run_metrics.PlayedGait
) -> float:
    rows = np.flatnonzero(replay.states["stamp_ns"] >= played.onset)
    if not margin.source or not rows.size:
        return math.nan
    length = float(replay.states["initial_length"][rows[0]])
    return predicted_margin(played.gait, parameters.replace(initial_length=length), margin.grooves)


def _early_end(run: Run, played: run_metrics.PlayedGait, events: Sequence[Event]) -> str:
    """Return the reason of an early end, with the first error that the driver reported; empty without an early end."""
    reason = run_metrics.early_end(run, played)
    errors = [e.text for e in events if e.source == "driver" and e.level == "error"]
    return f"{reason} ({errors[0]})" if reason and errors else reason


def _bands(
    position: run_metrics.Samples,
    energy: run_metrics.Samples,
    spans: Sequence[run_metrics.Window],
    direction: int,
    mass: float,
    missing: list[str],
) -> Bands:
    """Return the means over the first span, with the lowest and highest means over the other spans as bounds."""
    speeds = [direction * rate for rate in _rates(position, spans, "position of x1", missing)]
    powers = list(_rates(energy, spans, "power", missing))
    costs = [float(cost_of_transport(v, p, mass)) for v, p in zip(speeds, powers, strict=True)]
    if math.isnan(speeds[0]) or math.isnan(powers[0]):
        costs = [math.nan] * len(spans)
    return Bands(*(_band(values) for values in (speeds, powers, costs)))


def _band(values: list[float]) -> Band:
    mean, *single = values
    return Band(mean, min(single), max(single))


def _rates(
    samples: run_metrics.Samples, spans: Sequence[run_metrics.Window], name: str, missing: list[str]
) -> Iterator[float]:
    """Yield the mean rate over each span, or NaN if the samples do not cover it.

    Each reason for a NaN is appended to ``missing`` once.
    """
    for span in spans:
        try:
            yield run_metrics.mean_rate(samples, span, name)
        except RecordingError as error:
            if str(error) not in missing:
                missing.append(str(error))
            yield math.nan
