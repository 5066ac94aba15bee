# SPDX-License-Identifier: Apache-2.0
"""A stretch of a recording through the twin at once, from the state at its start to what the next run needs of it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from worm_model.parameters import Parameters
from worm_model.twin.by_sample import Replay, Series, series_of
from worm_model.twin.core import Twin
from worm_model.twin.hypotheses import hypotheses
from worm_model.twin.offline.beginnings import Stretch
from worm_model.twin.offline.cycles import (
    Finding,
    closings,
    number_cycles,
    watch_anchors,
    watch_power,
)
from worm_model.twin.offline.drive import (
    Drive,
    Estimates,
    Signal,
    driving_lengths,
    due,
    estimate,
)
from worm_model.twin.offline.instrument_comparison import (
    Observations,
    Triggers,
    accept,
    judge_lengths,
    measured_energy,
    predicted_positions,
    predicted_power,
    triggers,
)
from worm_model.twin.offline.motion import Motion, follow_lengths
from worm_model.twin.offline.record_columns import Judged, residual_columns, state_columns
from worm_model.twin.offline.sample_timeline import Array, Kind, Mask, Rows, Stamps, Timeline, only
from worm_model.twin.records import (
    NANOSECONDS,
    LengthSource,
    Notice,
    Severity,
    StateRecord,
)
from worm_model.twin.run_start import put_at_rest
from worm_model.twin.track import Knot, Row, Settled, Track, remembered_ns
from worm_model.twin.twin_settings import TwinSettings
from worm_model.twin.twin_state import Run, TwinState


@dataclass(frozen=True)
class Samples:
    """The samples of a stretch by kind; ``looks`` are the places of all that tracker and power say.

    ``now`` is the newest stamp heard at each place and after the last; ``next_ns`` that of the word of another run
    which ends the stretch, 0 if the recording does.
    """

    commands: Signal
    measured: Signal
    rear: Signal
    power: Signal
    looks: Rows
    now: Stamps
    next_ns: int


def samples_in(timeline: Timeline, stretch: Stretch, next_ns: int) -> Samples:
    """The samples of a stretch."""
    span = slice(stretch.first, stretch.last)
    kind, stamp, value = timeline.kind[span], timeline.stamp[span], timeline.value[span]

    def signal(wanted: int) -> Signal:
        place = np.flatnonzero((kind == wanted) & np.isfinite(value))
        return Signal(place, stamp[place], value[place])

    return Samples(
        commands=signal(Kind.COMMAND),
        measured=signal(Kind.LENGTH),
        rear=signal(Kind.POSITION),
        power=signal(Kind.POWER),
        looks=np.flatnonzero((kind == Kind.POSITION) | (kind == Kind.POWER)),
        now=np.append(timeline.now[span], next_ns),
        next_ns=next_ns,
    )


def follow_stretch(state: TwinState, samples: Samples, twin: Twin) -> tuple[TwinState, Replay]:
    """(the state at the end as far as another run needs it, the output) from the state at the start.

    The state's run has its end already, if there is one.

    Raises:
        Irregular: something that only samples one by one can tell.
        SimulationError: chatter.
    """
    parameters, settings = twin.effective_parameters(state), twin.settings
    estimates = estimate(samples.commands, state.actuation, parameters)
    state, motion = _move(state, samples, estimates, twin)
    found = triggers(samples.looks, samples.now, motion, estimates)
    seen = _seen(samples.rear, motion, found, settings)
    sight, accepted = accept(state.sight, seen, settings)
    seen = only(seen, accepted)
    state, off, origins = _put_in_frame(state, motion, seen, found)
    state = state.but(sight=sight)
    powers = _judge_powers(state.run, samples.power, motion, found, settings)
    state, positions, findings = _watch(state, seen, off, powers.seen, samples, found, twin)
    lengths = _judge_lengths(state.run, estimates, samples.measured, found, settings)
    judged = (positions, lengths, powers)
    residuals, messages, monitor = residual_columns(judged, findings, state.monitor, settings)
    published = due(estimates.stamp, state.estimated_ns, settings)
    output = Replay(
        states=_states(state, motion, origins, findings, found, parameters),
        residuals=residuals,
        messages=messages,
        lengths=_lengths(estimates, published, parameters.initial_length),
        notices=tuple(_notice(finding) for finding in findings),
    )
    return _at_end(state.but(monitor=monitor), samples, estimates.stamp[published], motion), output


# --- motion ---------------------------------------------------------------------------------------


def _move(
    state: TwinState, samples: Samples, estimates: Estimates, twin: Twin
) -> tuple[TwinState, Motion | None]:
    """(the state with a track at the start, the motion); None without any length."""
    model = twin.locomotion(state)
    last_place = len(samples.now) - 1 if samples.next_ns else None
    drive = driving_lengths(state, estimates, samples.measured, twin.settings, last_place)
    if drive is None:
        return state, None
    if state.track is None:
        state = put_at_rest(state, model, _knot(drive, 0))
    assert state.track is not None
    return state, follow_lengths(drive, state.track, model, twin.settings)


def _knot(drive: Drive, row: int) -> Knot:
    source = LengthSource.MEASURED if drive.measured[row] else LengthSource.ESTIMATED
    change, rate = float(drive.length_change[row]), float(drive.rate[row])
    return Knot(int(drive.stamp[row]), change, rate, source)


# --- comparison -----------------------------------------------------------------------------------


def _seen(
    signal: Signal, motion: Motion | None, found: Triggers, settings: TwinSettings
) -> Observations:
    """The positions whose time comes."""
    known = np.empty(0, np.int64) if motion is None else motion.drive.stamp
    return found.judge(signal, known, found.followed, _forgotten(found, settings))


def _forgotten(found: Triggers, settings: TwinSettings) -> Stamps:
    """Up to where the twin need not remember its motion at each comparison."""
    return found.followed - remembered_ns(settings.smoothing_s)


def _put_in_frame(
    state: TwinState, motion: Motion | None, seen: Observations, found: Triggers
) -> tuple[TwinState, Array, Array]:
    """(the state, how far (m) the positions are off without any moves, the twin's zero (m) at each state record)."""
    if motion is None:
        return state, np.empty(0), np.empty(0)
    run = state.run
    origins = np.full(len(motion.drive.flush_row) + 1, run.origin)
    expected = predicted_positions(motion, seen.stamp)
    if math.isnan(state.sight.position) and not run.start_ns and len(seen.stamp):
        # Before the first run the tracker's first word says where the robot stands.
        run = replace(run, origin=float(seen.value[0] - expected[0]))
        origins[_triggers_of_states(motion, found) > seen.trigger[0]] = run.origin
    return state.but(run=run), seen.value - expected - run.origin, origins


def _triggers_of_states(motion: Motion, found: Triggers) -> Rows:
    """The comparison that follows each state record, −1 for the start."""
    return np.append(-1, np.searchsorted(found.place, motion.drive.flush_place))


def _judge_powers(
    run: Run, power: Signal, motion: Motion | None, found: Triggers, settings: TwinSettings
) -> Judged:
    if motion is None:
        return _nothing()
    start = int(motion.drive.stamp[0])
    seen = found.judge(power, motion.drive.stamp, found.settled, _forgotten(found, settings))
    expected, used = predicted_power(motion, seen.stamp)
    residual = seen.value - expected
    # No window resolves the step of the length rate at the onset.
    counts = seen.stamp - run.start_ns > 4.0 * settings.smoothing_s * NANOSECONDS
    spent = measured_energy(start, seen.stamp, seen.value) if run.start_ns else np.nan
    return Judged(seen, residual, np.where(counts, residual, np.nan), spent - used)


def _judge_lengths(
    run: Run, estimates: Estimates, measured: Signal, found: Triggers, settings: TwinSettings
) -> Judged:
    seen, change = judge_lengths(found, estimates, measured, settings)
    residual = seen.value - run.initial_length - change
    return Judged(seen, residual, residual, np.full(len(residual), np.nan))


def _nothing() -> Judged:
    none, rows = np.empty(0), np.empty(0, np.intp)
    return Judged(Observations(rows, rows, np.empty(0, np.int64), none), none, none, none)


def _watch(
    state: TwinState,
    seen: Observations,
    off: Array,
    power: Observations,
    samples: Samples,
    found: Triggers,
    twin: Twin,
) -> tuple[TwinState, Judged, list[Finding]]:
    """(the state with its anchors and watch, the positions with the moves followed, what happened in its order)."""
    run, blank = state.run, np.full(len(off), np.nan)
    if run.gait is None:
        return state, Judged(seen, off, off, blank), []
    parameters = twin.effective_parameters(state)
    numbered = number_cycles(run, seen)
    ends = closings(run, numbered, found, samples.next_ns)
    anchors, positions, findings = watch_anchors(run, numbered, off, ends, parameters.pitch)
    state = state.but(anchors=anchors)
    pair = hypotheses(run.gait, parameters)
    if pair.telling:
        numbered = number_cycles(run, power)
        ends = closings(run, numbered, found, samples.next_ns)
        watch, alarms = watch_power(run, numbered, ends, pair)
        state, findings = state.but(watch=watch), sorted([*findings, *alarms], key=_in_order)
    return state, Judged(seen, positions.residual, positions.fault, blank), findings


def _in_order(finding: Finding) -> tuple[int, bool, int]:
    closing = finding.closing
    return closing.trigger, closing.row is None, closing.place


# --- output ---------------------------------------------------------------------------------------


def _states(
    state: TwinState,
    motion: Motion | None,
    origins: Array,
    findings: Sequence[Finding],
    found: Triggers,
    parameters: Parameters,
) -> Series:
    if motion is None:
        return series_of(StateRecord, ())
    moved = np.zeros(len(origins), np.int64)
    at, stamp = _triggers_of_states(motion, found), motion.drive.stamp
    stamp = stamp[np.append(0, motion.drive.flush_row)]
    for finding in findings:
        if finding.move is not None:
            after = (at > finding.closing.trigger) & (stamp >= finding.move.stamp_ns)
            moved[after] += finding.move.grooves
    return state_columns(motion, state.run, moved, origins, parameters)


def _lengths(estimates: Estimates, published: Mask, initial_length: float) -> Series:
    change = estimates.length_change[published]
    return {
        "stamp_ns": estimates.stamp[published],
        "length": initial_length + change,
        "length_change": change,
    }


def _notice(finding: Finding) -> Notice:
    return Notice(finding.closing.stamp, Severity.WARNING, finding.text)


# --- the end --------------------------------------------------------------------------------------


def _at_end(
    state: TwinState, samples: Samples, published: Stamps, motion: Motion | None
) -> TwinState:
    """What another run needs: where the motion ended, and when what was heard last."""
    if len(published):
        state = state.but(estimated_ns=int(published[-1]))
    if len(samples.measured.stamp):
        state = state.but(measured_ns=int(samples.measured.stamp[-1]))
    return state if motion is None else state.but(track=_track_at_end(motion))


def _track_at_end(motion: Motion) -> Track:
    """A track that remembers nothing but its last row."""
    drive, last = motion.drive, len(motion.rate) - 1
    columns = (*motion.columns.values(), motion.rate, motion.power, motion.energy)
    row = Row(_knot(drive, last), *(float(column[last]) for column in columns))
    settled = Settled(row.stamp_ns, row.power, float(motion.final_energy[last]))
    return Track(int(drive.stamp[0]), motion.end, (row,), (settled,))
