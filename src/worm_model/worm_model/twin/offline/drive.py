# SPDX-License-Identifier: Apache-2.0
"""Which lengths drive the twin over a stretch, and when it follows them: `worm_model.twin.core` in columns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from worm_model.parameters import Parameters
from worm_model.simulation.kernel.lag import follow_target
from worm_model.simulation.kernel.recording_loops import pick_due
from worm_model.simulation.smoothing import FEWEST_SAMPLES
from worm_model.twin.estimated_length import Actuation
from worm_model.twin.offline.sample_timeline import Array, Irregular, Mask, Rows, Stamps, only
from worm_model.twin.records import NANOSECONDS
from worm_model.twin.track import HISTORY_S, WINDOW_SAMPLES
from worm_model.twin.twin_settings import TwinSettings
from worm_model.twin.twin_state import TwinState


@dataclass(frozen=True)
class Signal:
    """Samples of one kind, each array (samples,): where in the stretch they are taken, stamps in ns, values in SI."""

    place: Rows
    stamp: Stamps
    value: Array


@dataclass(frozen=True)
class Estimates:
    """The length estimated from the command, at its stamps, each array (commands,): ΔL in m, its rate in m/s."""

    place: Rows
    stamp: Stamps
    length_change: Array
    rate: Array


@dataclass(frozen=True)
class Drive:
    """The driving lengths, row 0 where the motion starts, each array (rows,) or (flushes,).

    ΔL in m, its exact rate in m/s (NaN: measured); ``place`` is where in the stretch each is queued (−1: before it),
    ``flush_row`` the last row of each flush and ``flush_place`` where it happens.
    """

    place: Rows
    stamp: Stamps
    length_change: Array
    rate: Array
    measured: Mask
    flush_row: Rows
    flush_place: Rows


def estimate(commands: Signal, before: Actuation | None, parameters: Parameters) -> Estimates:
    """What the actuation model makes of the command, as `worm_model.twin.estimated_length.respond`."""
    if before is not None:
        # Older ones are of the time before a run that began late.
        heard = commands.stamp >= before.stamp_ns
        commands = only(commands, heard)
    if before is None or not before.engaged:
        still = np.zeros(len(commands.stamp))
        return Estimates(commands.place, commands.stamp, still, still)
    time = np.append(0.0, (commands.stamp - before.stamp_ns) / NANOSECONDS)
    command = np.append(before.command, commands.value)
    change = _respond(time, command, before.length_change, parameters)
    target = parameters.gain * np.minimum(command, -parameters.slack)
    rate = (target - change) / parameters.time_constant
    return Estimates(commands.place, commands.stamp, change[1:], rate[1:])


def _respond(time: Array, command: Array, start: float, parameters: Parameters) -> Array:
    """ΔL at the times of a command that moves in straight lines."""
    above = command + parameters.slack
    crossing = np.flatnonzero(above[:-1] * above[1:] < 0.0)  # the clip is split where it opens
    share = above[crossing] / (above[crossing] - above[crossing + 1])
    at = time[crossing] + share * np.diff(time)[crossing]
    target = np.minimum(np.insert(command, crossing + 1, -parameters.slack), -parameters.slack)
    response = np.empty_like(target)
    times = np.insert(time, crossing + 1, at)
    follow_target(times, parameters.gain * target, parameters.time_constant, start, response)
    return np.delete(response, crossing + 1 + np.arange(len(crossing)))


def due(stamp: Stamps, last: int, settings: TwinSettings) -> Mask:
    """Which of some stamps are published, the last one having been ``last``."""
    chosen = np.empty(len(stamp), np.bool_)
    pick_due(stamp, last, round(settings.output_period_s * NANOSECONDS), chosen)
    return chosen


def driving_lengths(
    state: TwinState,
    estimates: Estimates,
    measured: Signal,
    settings: TwinSettings,
    last_place: int | None,
) -> Drive | None:
    """The measured lengths, and the estimates where those are stale; None if there is no length at all.

    ``state`` is that at the start of the stretch; at ``last_place``, if there is one, what is left is followed.

    Raises:
        Irregular: a pause, or lengths so dense that the twin leaves some out.
    """
    chosen, queued = _stale_estimates(estimates, measured, state.measured_ns, settings)
    place = np.concatenate([queued, measured.place])
    stamp = np.concatenate([estimates.stamp[chosen], measured.stamp])
    change = measured.value - state.run.initial_length
    change = np.concatenate([estimates.length_change[chosen], change])
    rate = np.concatenate([estimates.rate[chosen], np.full(len(measured.stamp), np.nan)])
    is_measured = np.arange(len(stamp)) >= np.count_nonzero(chosen)
    if state.track is not None:
        start = state.track.rows[-1].knot
        place, stamp = np.append(place, -1), np.append(stamp, start.stamp_ns)
        change, rate = np.append(change, start.length_change), np.append(rate, start.rate)
        is_measured = np.append(is_measured, False)
    order = np.lexsort((stamp, place))
    newest = np.maximum.accumulate(stamp[order])
    order = order[np.append(True, np.diff(newest) > 0)[: len(order)]]
    if not len(order):
        return None
    place, stamp = place[order], stamp[order]
    flushes = _flushes(place, stamp, settings, last_place)
    kept = order[: flushes[0][-1] + 1 if len(flushes[0]) else 1]
    rows = slice(0, len(kept))
    drive = Drive(place[rows], stamp[rows], change[kept], rate[kept], is_measured[kept], *flushes)
    _check(drive, settings)
    return drive


def _stale_estimates(
    estimates: Estimates, measured: Signal, last_ns: int, settings: TwinSettings
) -> tuple[Mask, Rows]:
    """(which estimates drive, where each of them is queued): all since a measured length that has gone stale."""
    known, place = np.append(last_ns, measured.stamp), np.append(-1, measured.place)
    before = np.searchsorted(place, estimates.place) - 1
    stale = estimates.stamp > known[before] + round(settings.measured_stale_s * NANOSECONDS)
    gaps, first = np.unique(before[stale], return_index=True)
    chosen = np.isin(before, gaps)
    begins = estimates.place[stale][first]
    queued = np.maximum(estimates.place[chosen], begins[np.searchsorted(gaps, before[chosen])])
    return chosen, queued


def _flushes(
    place: Rows, stamp: Stamps, settings: TwinSettings, last_place: int | None
) -> tuple[Rows, Rows]:
    """(last row, place) of each flush."""
    ends = np.append(np.diff(place) > 0, True)  # what is queued at one place is followed at once
    ends[0] = False
    row = np.flatnonzero(ends)
    row = row[due(stamp[row], int(stamp[0]), settings)]
    where = place[row]
    left = len(place) - 1
    if last_place is not None and left > (row[-1] if len(row) else 0):
        row, where = np.append(row, left), np.append(where, last_place)
    return row, where


def _check(drive: Drive, settings: TwinSettings) -> None:
    """Raises Irregular where the twin would tell of a pause, or would thin the lengths out for its windows."""
    pause = min(HISTORY_S, settings.pause_s) * NANOSECONDS
    if np.diff(drive.stamp).max(initial=0) > pause:
        raise Irregular
    stamp = drive.stamp[drive.measured]
    if too_dense(stamp, 2.0 * settings.smoothing_s).any():
        raise Irregular


def too_dense(stamp: Stamps, window_s: float) -> Mask:
    """At which measured lengths the window before them holds more than the twin smooths over."""
    first = np.searchsorted(stamp, stamp - round(window_s * NANOSECONDS))
    count = np.arange(len(stamp)) - first + 1
    span = np.maximum((stamp - stamp[first]) / NANOSECONDS, 1e-9) if len(stamp) else stamp
    return (count >= FEWEST_SAMPLES) & (count * window_s / span >= 2 * WINDOW_SAMPLES)
