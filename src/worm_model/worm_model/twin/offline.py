# SPDX-License-Identifier: Apache-2.0
"""The last run of a recording through the twin, all at once instead of sample by sample, for reports.

`predict_run` yields the residuals that `Twin.step` yields, to rounding, many times faster: the motion is followed in
one call, the lengths are smoothed in one, the comparisons are columns. It is meant for recordings in which nothing
happens that only a sample-by-sample twin can judge; of any other it says so by returning None. A test holds
both against each other.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from worm_model.parameters import Parameters
from worm_model.run import GaitStates, Run
from worm_model.simulator import Locomotion, SimulationError
from worm_model.smoothing import smooth
from worm_model.twin.anchors import observe_anchors
from worm_model.twin.core import Twin
from worm_model.twin.observations import CLOSE_S, TOP_SPEED
from worm_model.twin.offline_inputs import (
    Drive,
    Estimates,
    Inputs,
    Signal,
    admit,
    driving_lengths,
    estimate,
)
from worm_model.twin.records import NANOSECONDS, Activity, MeasuredLength, TrackerSample
from worm_model.twin.replay import Series, gait_at
from worm_model.twin.rest import GUARD_NS, observe_rest
from worm_model.twin.run import PLAYING, SAME_RUN_NS, begin_run
from worm_model.twin.settings import DEFAULTS, TwinSettings
from worm_model.twin.state import TwinState
from worm_model.twin.track import HISTORY_S, force_at_rate

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]

_LOOK_FROM = 0.5  # phase of a cycle, before which the anchors' judgement takes no samples
RESIDUALS = ("stamp_ns", "rear_position", "length", "power", "energy")


@dataclass(frozen=True)
class Prediction:
    """The series of a `worm_model.twin.replay.Replay` that a report is made of, without the twin's health.

    Attributes:
        states: `stamp_ns` and `rear_groove`.
        residuals: RESIDUALS, first those of x1, then of length, then of power and energy.
    """

    states: Series
    residuals: Series


def predict_run(
    run: Run, parameters: Parameters, settings: TwinSettings = DEFAULTS
) -> Prediction | None:
    """What the twin makes of the last run; None if it is not a regular one.

    Regular is a first run that the driver announced by resting, whose tracker saw the robot at rest, with no gap in
    the driving length that the twin's memory does not bridge, and no jump of the tracker.
    """
    announced = _announced_onset(run.gait_state, settings)
    if announced is None:
        return None
    onset, since = announced
    inputs = admit(run)
    begun = _begin(run.gait_state, inputs, onset, parameters, settings)
    played = inputs.since(since)
    if begun is None or _tracker_jumps(inputs, onset, settings) or not len(played.commands.stamp):
        return None
    if _tracker_pauses(played):
        return None
    effective = parameters.replace(initial_length=begun.run.initial_length)
    estimates = estimate(played.commands, onset, effective)
    drive = driving_lengths(estimates, inputs.measured, since, effective.initial_length, settings)
    if np.diff(drive.stamp).max(initial=0) > HISTORY_S * NANOSECONDS:
        return None
    try:
        motion = _follow(Locomotion(effective, begun.run.direction), drive)
    except SimulationError:
        return None
    states, positions = _compare_positions(drive, motion, played.rear, begun, effective)
    lengths = _compare_lengths(estimates, drive, played, effective.initial_length, settings)
    powers = _compare_powers(drive, motion, played.power, effective, settings)
    parts = (positions, lengths, powers)
    residuals = {name: np.concatenate([part[name] for part in parts]) for name in RESIDUALS}
    return Prediction(states, residuals)


# --- the start ------------------------------------------------------------------------------------


def _announced_onset(states: GaitStates, settings: TwinSettings) -> tuple[int, int] | None:
    """(onset, first stamp that counts) in ns of the last run, if the driver rested before it and told of it in time."""
    playing = np.flatnonzero(np.isin(states.state, PLAYING) & (states.onset > 0))
    if not len(playing):
        return None
    # The driver states the onset anew with each cycle; the first word of it counts.
    first = int(playing[0])
    onset = int(states.onset[first])
    # A run before would have left the fins as only the samples tell.
    one_run = (np.abs(states.onset[playing] - onset) <= SAME_RUN_NS).all()
    rested = first > 0 and states.state[first - 1] == Activity.RESTING
    delay = int(states.stamp[first]) - onset
    in_time = -GUARD_NS < delay <= settings.start_hold_s * NANOSECONDS
    if not (one_run and rested and in_time) or gait_at(states, first) is None:
        return None
    # What comes at the onset itself is of the run only if this has been announced by then.
    return onset, onset if delay <= 0 else onset + 1


def _end_of_run(states: GaitStates, onset: int) -> int:
    """Stamp (ns) of the first word that the run is over; 0 if there is none."""
    over = ~np.isin(states.state, PLAYING) & (states.stamp > onset)
    return int(states.stamp[over][0]) if over.any() else 0


def _tracker_pauses(played: Inputs) -> bool:
    """Whether the twin would judge a cycle without waiting for the tracker any longer."""
    newest = max(int(played.commands.stamp[-1]), int(played.rear.stamp.max(initial=0)))
    gaps = np.diff(played.rear.stamp, append=newest)
    return bool((gaps > CLOSE_S * NANOSECONDS).any())


def _tracker_jumps(inputs: Inputs, onset: int, settings: TwinSettings) -> bool:
    """Whether the twin would refuse a position from shortly before the onset on."""
    seen = inputs.rear.since(onset - NANOSECONDS)
    reach = settings.tracker_gate_m + TOP_SPEED * np.diff(seen.stamp) / NANOSECONDS
    return bool((np.abs(np.diff(seen.value)) > reach).any())


def _begin(
    states: GaitStates, inputs: Inputs, onset: int, parameters: Parameters, settings: TwinSettings
) -> TwinState | None:
    """The twin at the onset, as the samples at rest put it there; None if no instrument saw it then."""
    span = onset - round(settings.rest_s * NANOSECONDS) - 2 * GUARD_NS, onset
    front = dict(inputs.front.within(*span))
    samples: list[MeasuredLength | TrackerSample] = [
        MeasuredLength(stamp, length) for stamp, length in inputs.measured.within(*span)
    ]
    samples += [
        TrackerSample(stamp, position, front.get(stamp, math.nan))
        for stamp, position in inputs.rear.within(*span)
    ]
    state = Twin(parameters, settings).start()
    rest = state.rest
    for sample in samples:
        rest = observe_rest(rest, sample, settings.rest_s)
    nowhere = replace(state.run, origin=math.nan)
    gait = gait_at(states, int(np.flatnonzero(states.onset == onset)[0]))
    begun, _ = begin_run(state.but(rest=rest, run=nowhere), onset, gait, parameters, settings)
    begun = begun.but(run=replace(begun.run, end_ns=_end_of_run(states, onset)))
    return None if math.isnan(begun.run.origin) or not begun.run.length_seen else begun


@dataclass(frozen=True)
class Motion:
    """The twin at the driving lengths, in its own frame, SI; rate and force of the lines between these lengths."""

    x1: Array
    rear_groove: Array
    length_rate: Array
    cable_force: Array


def _follow(model: Locomotion, drive: Drive) -> Motion:
    """The motion from rest at the onset, which no line has led to.

    Raises `worm_model.simulator.SimulationError` on chatter.
    """
    times = (drive.stamp - drive.stamp[0]) / NANOSECONDS
    rest = model.start(0.0, float(drive.length_change[0]))
    instant = [1.0 / NANOSECONDS]  # the kernel tells nothing of no time at all
    parts = [model.follow(rest, instant, drive.length_change[:1])[1]]
    if len(times) > 1:
        parts.append(model.follow(rest, times[1:], drive.length_change[1:])[1])
    columns = {
        row.name: np.concatenate([getattr(part, row.name) for part in parts]).astype(np.float64)
        for row in fields(Motion)
    }
    return Motion(**columns)


# --- the comparisons ------------------------------------------------------------------------------


def _columns(stamp: Stamps, **known: Array) -> Series:
    """Residuals of one kind, the others NaN."""
    columns: dict[str, Any] = {name: np.full(len(stamp), np.nan) for name in RESIDUALS}
    return {**columns, "stamp_ns": stamp, **known}


def _compare_positions(
    drive: Drive, motion: Motion, tracker: Signal, begun: TwinState, parameters: Parameters
) -> tuple[Series, Series]:
    """(the twin's grooves, residuals of x1), missed and extra grooves followed as the twin follows them."""
    within = tracker.stamp <= drive.stamp[-1]
    stamp = tracker.stamp[within]
    zero = int(drive.stamp[0])
    expected = np.interp(stamp - zero, drive.stamp - zero, motion.x1) + begun.run.origin
    residual = tracker.value[within] - expected
    grooves = motion.rear_groove.copy()
    anchors, moves = begun.anchors, 0
    gait = begun.run.gait
    assert gait is not None
    phase = ((stamp - zero) / NANOSECONDS * gait.frequency) % 1.0
    cycles = np.floor((stamp - zero) / NANOSECONDS * gait.frequency + 1e-9)
    begins = np.concatenate([[False], np.diff(cycles) > 0])
    for row in np.flatnonzero((phase >= _LOOK_FROM) | begins):
        cycle = begun.run.cycle_at(int(stamp[row]))
        assert cycle is not None
        anchors, _ = observe_anchors(
            anchors, cycle, float(residual[row]), parameters.pitch, begun.run.direction
        )
        if len(anchors.moves) + abs(anchors.base) > moves:
            moves = len(anchors.moves) + abs(anchors.base)
            move = anchors.moves[-1]
            residual[stamp >= move.stamp_ns] -= move.grooves * parameters.pitch
            grooves[drive.stamp >= move.stamp_ns] += move.grooves
    states = {"stamp_ns": drive.stamp, "rear_groove": grooves}
    return states, _columns(stamp, rear_position=residual)


def _compare_lengths(
    estimates: Estimates,
    drive: Drive,
    inputs: Inputs,
    initial_length: float,
    settings: TwinSettings,
) -> Series:
    """Residuals of the lengths that the command was still there for."""
    # An estimate is compared when anything but a command comes after it.
    heard = max(
        int(s.stamp.max(initial=0)) for s in (drive, inputs.power, inputs.rear, inputs.front)
    )
    used = slice(estimates.first, int(np.searchsorted(estimates.stamp, heard, side="right")))
    known, change = estimates.stamp[used], estimates.length_change[used]
    stamp = inputs.measured.stamp
    if not len(known) or not len(stamp):
        return _columns(stamp[:0])
    before = known[np.maximum(np.searchsorted(known, stamp, side="right") - 1, 0)]
    stale = round(settings.measured_stale_s * NANOSECONDS)
    within = (stamp >= known[0]) & (stamp <= known[-1]) & (stamp - before <= stale)
    stamp = stamp[within]
    expected = np.interp(stamp - known[0], known - known[0], change) + initial_length
    return _columns(stamp, length=inputs.measured.value[within] - expected)


def _compare_powers(
    drive: Drive, motion: Motion, power: Signal, parameters: Parameters, settings: TwinSettings
) -> Series:
    """Residuals of power and of the energy since the onset, where the twin's own are final."""
    last = _settled(drive, settings)
    time = ((drive.stamp - drive.stamp[0]) / NANOSECONDS)[: last + 1]
    rate = _rates(drive, settings)
    force = force_at_rate(motion.cable_force, motion.length_rate, rate, parameters)
    work = np.maximum(-force * rate, 0.0)[: last + 1]
    predicted = parameters.idle_power + parameters.power_factor * work
    energy = _integral(time, predicted)
    within = power.stamp <= drive.stamp[last]
    stamp, measured = power.stamp[within], power.value[within]
    at = (stamp - drive.stamp[0]) / NANOSECONDS
    expected = np.interp(at, time, predicted)
    row = np.maximum(np.searchsorted(time, at, side="left") - 1, 0)
    used = energy[row] + 0.5 * (predicted[row] + expected) * (at - time[row])
    spent = np.zeros(len(at))
    later = at > 0.0  # the first of these counts from the onset on
    values = np.concatenate([measured[later][:1], measured[later]])
    spent[later] = _integral(np.concatenate([[0.0], at[later]]), values)[1:]
    return _columns(stamp, power=measured - expected, energy=spent - used)


def _integral(time: Array, value: Array) -> Array:
    """By trapezoids from the first time on."""
    steps = 0.5 * (value[1:] + value[:-1]) * np.diff(time)
    return np.concatenate([[0.0], np.cumsum(steps)])[: len(value)]


def _settled(drive: Drive, settings: TwinSettings) -> int:
    """Last row whose power is final: all before the first measured length whose window is not full."""
    limit = drive.stamp[-1] - round(settings.smoothing_s * NANOSECONDS)
    pending = np.flatnonzero(drive.measured & (drive.stamp > limit))
    return int(pending[0]) - 1 if len(pending) else len(drive.stamp) - 1


def _rates(drive: Drive, settings: TwinSettings) -> Array:
    """Final rates in m/s: exact where the estimate drives, smoothed where a measured length does."""
    rate = drive.rate.copy()
    rows = np.flatnonzero(drive.measured)
    if not len(rows):
        return rate
    time = (drive.stamp[rows] - drive.stamp[0]) / NANOSECONDS
    length, half = drive.length_change[rows], settings.smoothing_s
    found = smooth(time, length, time, half, half).rate
    unknown = ~np.isfinite(found)
    if unknown.any():  # then the rate known at once stays, if there is one
        found[unknown] = smooth(time, length, time[unknown], 2.0 * half, 0.0).rate
    rate[rows] = np.where(np.isfinite(found), found, rate[rows])
    return rate
