# SPDX-License-Identifier: Apache-2.0
"""The digital twin: a pure function of the samples in the order in which they come.

``state, output = twin.step(state, samples)``; no clock is read, nothing is drawn, so that a replay of the same
samples yields the same output to rounding, live or offline, one by one or all at once.

What it does with its samples:

- **Length.** The measured length drives; when it is older than ``measured_stale_s`` against the command, the
  estimate from the command does, until measured ones come again. `StateRecord.length_source` says which.
- **Order.** Each stream must ascend; across streams a measured length may be up to ``measured_stale_s`` behind
  the command, tracker and power up to a second behind the length, without any effect on the outcome. While
  the driver rests before a gait, the twin stays ``start_hold_s`` behind, so that the onset finds it before the
  first moved length.
- **Late, duplicate, ahead, not a number, clock jump back or ahead**: see `worm_model.twin.streams`.
- **Missing.** Between driving lengths the body moves in a straight line; a gap beyond ``pause_s`` is reported.
- **Run.** At a gait's onset the twin is put at rest: x1 where the tracker saw the rear module over the last
  ``rest_s``, L0 the mean measured length of that span (else that of the run before, else the parameter), energy 0.
  The fins stand as the run before left them (`worm_model.twin.pose`), unless the tracker saw that the
  robot was moved. Without any gait state a run begins where the command first leaves 0.
- **Parameters** may change between two steps (another `Twin` on the same state); L0 stays the run's own.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import lru_cache
from typing import TypeGuard

from worm_model.parameters import PAPER, Parameters
from worm_model.simulation.closed_form import front_groove, groove_phase
from worm_model.simulation.simulator import Locomotion, SimulationError
from worm_model.twin.estimated_length import Actuation, respond
from worm_model.twin.observations import close_cycles, compare
from worm_model.twin.records import (
    NANOSECONDS,
    CommandedLength,
    GaitSample,
    LengthRecord,
    LengthSource,
    MeasuredLength,
    Notice,
    Output,
    PowerSample,
    ResidualRecord,
    Sample,
    Severity,
    StateRecord,
    TrackerSample,
)
from worm_model.twin.rest import observe_rest
from worm_model.twin.run_start import (
    Run,
    begin_implied_run,
    begin_run,
    holding,
    is_new_run,
    put_at_rest,
    run_goes_on,
)
from worm_model.twin.streams import JUMPS, admit
from worm_model.twin.track import HISTORY_S, Knot, Track, follow, force_at_rate
from worm_model.twin.twin_settings import DEFAULTS, TwinSettings
from worm_model.twin.twin_state import Observation, Pose, TwinState

__all__ = ["Twin", "TwinSettings", "TwinState"]


@dataclass
class _Sink:
    """Collects the output of one step."""

    states: list[StateRecord] = field(default_factory=list)
    residuals: list[ResidualRecord] = field(default_factory=list)
    lengths: list[LengthRecord] = field(default_factory=list)
    notices: list[Notice] = field(default_factory=list)

    def freeze(self) -> Output:
        return Output(
            tuple(self.states), tuple(self.residuals), tuple(self.lengths), tuple(self.notices)
        )


@dataclass(frozen=True)
class Twin:
    """The twin of a robot with these parameters; it holds no state."""

    parameters: Parameters = PAPER
    settings: TwinSettings = DEFAULTS

    def start(self) -> TwinState:
        """The state before any sample."""
        pose = Pose(front_groove=front_groove(self.parameters))
        return TwinState(run=Run(initial_length=self.parameters.initial_length, pose=pose))

    def step(self, state: TwinState, samples: Iterable[Sample]) -> tuple[TwinState, Output]:
        """(state after the samples, what they yield), the samples in the order in which they came."""
        sink = _Sink()
        for sample in samples:
            state = self._admit(state, sample, sink)
        return state, sink.freeze()

    # --- samples --------------------------------------------------------------------------------

    def _admit(self, state: TwinState, sample: Sample, sink: _Sink) -> TwinState:
        streams, verdict, ready = admit(state.streams, sample, self.settings)
        if verdict in JUMPS:
            text = f"{verdict.value}: the twin starts anew"
            sink.notices.append(Notice(sample.stamp_ns, Severity.WARNING, text))
            state = self.start()
        state = state.but(streams=streams)
        for admitted in ready:
            state = self._enter(state, admitted, sink)
        return state

    def _enter(self, state: TwinState, sample: Sample, sink: _Sink) -> TwinState:
        if isinstance(sample, GaitSample):
            return self._take_gait(state, sample, sink)
        if holding(state):
            held = tuple(sorted((*state.held, sample), key=_stamp_of))
            newest = state.streams.now_ns - round(self.settings.start_hold_s * NANOSECONDS)
            return self._release(state.but(held=held), newest, sink)
        return self._take(state, sample, sink)

    def _release(self, state: TwinState, until_ns: int, sink: _Sink) -> TwinState:
        """Takes the held samples up to a stamp."""
        ready = [sample for sample in state.held if sample.stamp_ns <= until_ns]
        state = state.but(held=state.held[len(ready) :])
        for sample in ready:
            state = self._take(state, sample, sink)
        return state

    def _take_gait(self, state: TwinState, sample: GaitSample, sink: _Sink) -> TwinState:
        begins = is_new_run(state, sample)
        if begins:
            state = self._release(state, sample.onset_ns, sink)
            state = self._end(self._flush(state, sink), sink)
        state = state.but(activity=sample.activity)
        if begins:
            state, text = begin_run(
                state, sample.onset_ns, sample.gait, self.parameters, self.settings
            )
            sink.notices.append(Notice(sample.stamp_ns, Severity.INFO, text))
            state = self._start_track(state, sink)
        else:
            state = run_goes_on(state, sample)
        if state.held and not holding(state):
            state = self._release(state, state.held[-1].stamp_ns, sink)
        return state

    def _take(self, state: TwinState, sample: Sample, sink: _Sink) -> TwinState:
        if isinstance(sample, CommandedLength):
            return self._take_command(state, sample, sink)
        if not state.run.active and isinstance(sample, MeasuredLength | TrackerSample):
            state = state.but(rest=observe_rest(state.rest, sample, self.settings.rest_s))
        if self._comparable(sample, state):
            state = state.but(observations=(*state.observations, sample))
        if isinstance(sample, MeasuredLength):
            return self._drive_measured(state, sample, sink)
        return self._compare(state, sink)

    def _comparable(self, sample: Sample, state: TwinState) -> TypeGuard[Observation]:
        """Whether there is, or will be, something to compare a sample with; a length without commands has nothing."""
        if not isinstance(sample, MeasuredLength):
            return isinstance(sample, TrackerSample | PowerSample)
        stale = round(self.settings.measured_stale_s * NANOSECONDS)
        return bool(state.estimates) and sample.stamp_ns <= state.estimates[-1].stamp_ns + stale

    # --- the driving length ---------------------------------------------------------------------

    def _take_command(self, state: TwinState, sample: CommandedLength, sink: _Sink) -> TwinState:
        before = state.actuation or Actuation(sample.stamp_ns)
        if begin_implied_run(state, before, sample):
            state = self._begin_implied(state, before, sink)
            before = state.actuation or before
        parameters = self.effective_parameters(state)
        if sample.stamp_ns < before.stamp_ns:  # of the time before a run that began late
            return state
        after = respond(before, sample.stamp_ns, sample.length_change, parameters)
        knot = Knot(after.stamp_ns, after.length_change, after.rate, LengthSource.ESTIMATED)
        state = self._publish_length(state, after, parameters, sink)
        state = state.but(
            actuation=after,
            estimates=_recent((*state.estimates, knot)),
            waiting=(*state.waiting, knot),
        )
        return self._drive_estimated(state, sink)

    def _publish_length(
        self, state: TwinState, after: Actuation, parameters: Parameters, sink: _Sink
    ) -> TwinState:
        period = round(self.settings.output_period_s * NANOSECONDS)
        if after.stamp_ns - state.estimated_ns < period:
            return state
        length = parameters.initial_length + after.length_change
        sink.lengths.append(LengthRecord(after.stamp_ns, length, after.length_change))
        return state.but(estimated_ns=after.stamp_ns)

    def _begin_implied(self, state: TwinState, before: Actuation, sink: _Sink) -> TwinState:
        state = self._end(self._flush(state, sink), sink)
        state, text = begin_run(state, before.stamp_ns, None, self.parameters, self.settings)
        sink.notices.append(Notice(before.stamp_ns, Severity.INFO, text))
        return self._start_track(state, sink)

    def _drive_estimated(self, state: TwinState, sink: _Sink) -> TwinState:
        """The estimates drive once the measured lengths are stale."""
        stale = state.measured_ns + round(self.settings.measured_stale_s * NANOSECONDS)
        if state.waiting[-1].stamp_ns <= stale:
            return state
        for knot in state.waiting:
            state = self._queue(state, knot, sink)
        return self._flush_if_due(state.but(waiting=()), sink)

    def _drive_measured(self, state: TwinState, sample: MeasuredLength, sink: _Sink) -> TwinState:
        change = sample.length - state.run.initial_length
        waiting = tuple(knot for knot in state.waiting if knot.stamp_ns > sample.stamp_ns)
        state = state.but(measured_ns=sample.stamp_ns, waiting=waiting)
        knot = Knot(sample.stamp_ns, change, math.nan, LengthSource.MEASURED)
        return self._flush_if_due(self._queue(state, knot, sink), sink)

    def _queue(self, state: TwinState, knot: Knot, sink: _Sink) -> TwinState:
        if state.track is None and not state.queued:
            return self._start_track(state, sink, knot)
        end = state.end_ns
        if knot.stamp_ns <= end:
            return state
        gap = (knot.stamp_ns - end) / NANOSECONDS
        if gap > self.settings.pause_s:
            text = f"no length for {gap:.2f} s; the body is taken to have moved in a straight line"
            sink.notices.append(Notice(knot.stamp_ns, Severity.WARNING, text))
        return state.but(queued=(*state.queued, knot))

    # --- the motion -----------------------------------------------------------------------------

    def _start_track(self, state: TwinState, sink: _Sink, knot: Knot | None = None) -> TwinState:
        state = put_at_rest(state, self.locomotion(state), knot)
        assert state.track is not None
        sink.states.append(self._record(state, state.track))
        return state

    def _flush_if_due(self, state: TwinState, sink: _Sink) -> TwinState:
        period = round(self.settings.output_period_s * NANOSECONDS)
        if state.queued and state.queued[-1].stamp_ns - state.published_ns >= period:
            return self._flush(state, sink)
        return state

    def _flush(self, state: TwinState, sink: _Sink) -> TwinState:
        """Lets the motion follow the queued lengths and publishes where it comes to."""
        if not state.queued or state.track is None:
            return state
        try:
            track = follow(
                state.track, state.queued, self.locomotion(state), self.settings.smoothing_s
            )
        except SimulationError as error:
            text = f"the motion could not be followed ({error}): the twin is put at rest"
            sink.notices.append(Notice(state.end_ns, Severity.ERROR, text))
            return self._start_track(state.but(track=None), sink, state.queued[-1])
        state = state.but(track=track, queued=(), published_ns=track.stamp_ns)
        sink.states.append(self._record(state, track))
        return self._compare(state, sink)

    def _compare(self, state: TwinState, sink: _Sink) -> TwinState:
        state, records, notices = compare(state, self.effective_parameters(state), self.settings)
        sink.residuals += records
        sink.notices += notices
        return state

    def _end(self, state: TwinState, sink: _Sink) -> TwinState:
        """Judges what is left of a run, before the next one."""
        end = state.run.end_ns
        state, notices = close_cycles(state, end, self.effective_parameters(state))
        sink.notices += notices
        return state

    def _record(self, state: TwinState, track: Track) -> StateRecord:
        parameters = self.effective_parameters(state)
        row = track.rows[-1]
        moved = state.anchors.grooves_at(row.stamp_ns)
        zero = state.run.origin + moved * parameters.pitch
        mu = parameters.front_mass / parameters.mass
        force = force_at_rate(row.chord_force, row.chord_rate, row.rate, parameters)
        return StateRecord(
            stamp_ns=row.stamp_ns,
            length_source=row.knot.source,
            initial_length=parameters.initial_length,
            groove_phase=groove_phase(parameters),
            length=parameters.initial_length + row.knot.length_change,
            length_rate=row.rate,
            rear_position=zero + row.x1,
            front_position=zero + row.x2,
            rear_velocity=row.y_rate - mu * row.rate,
            front_velocity=row.y_rate + (1.0 - mu) * row.rate,
            rear_anchor=zero + row.rear_groove * parameters.pitch,
            front_anchor=zero + row.front_groove * parameters.pitch,
            rear_groove=int(row.rear_groove) + moved,
            front_groove=int(row.front_groove) - state.run.pose.front_groove + moved,
            cable_force=force,
            rear_fin_force=row.rear_force,
            front_fin_force=row.front_force,
            power=row.power,
            energy=track.energy,
        )

    def effective_parameters(self, state: TwinState) -> Parameters:
        """The parameters with the L0 of the state's run."""
        return _with_length(self.parameters, state.run.initial_length)

    def locomotion(self, state: TwinState) -> Locomotion:
        """The locomotion model of the state's run."""
        return Locomotion(self.effective_parameters(state), state.run.direction)


@lru_cache(maxsize=16)
def _with_length(parameters: Parameters, initial_length: float) -> Parameters:
    return parameters.replace(initial_length=initial_length)


def _stamp_of(sample: Sample) -> int:
    return sample.stamp_ns


def _recent(knots: tuple[Knot, ...]) -> tuple[Knot, ...]:
    """Forgets what is older than the history, in pieces."""
    limit = knots[-1].stamp_ns - round(2.0 * HISTORY_S * NANOSECONDS)
    if knots[0].stamp_ns > limit:
        return knots
    return tuple(knot for knot in knots if knot.stamp_ns > limit + NANOSECONDS)
