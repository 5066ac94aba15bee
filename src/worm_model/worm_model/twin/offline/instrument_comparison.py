# SPDX-License-Identifier: Apache-2.0
"""What the instruments say in a stretch against the motion: `worm_model.twin.observations` in columns."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from worm_model.simulation.quadrature import accumulated
from worm_model.twin.observations import CLOSE_S, TOP_SPEED, look, stays
from worm_model.twin.offline.drive import Estimates, Signal
from worm_model.twin.offline.motion import Motion
from worm_model.twin.offline.sample_timeline import Array, Irregular, Mask, Rows, Stamps, only
from worm_model.twin.records import NANOSECONDS, TrackerSample
from worm_model.twin.track import HISTORY_S
from worm_model.twin.twin_settings import TwinSettings
from worm_model.twin.twin_state import Sight


@dataclass(frozen=True)
class Observations:
    """Observations of one kind in the order in which they are judged, each array (observations,).

    ``trigger`` is the comparison that judges each, ``place`` where in the stretch it was taken, ``stamp`` in ns,
    ``value`` L or x1 in m, or W.
    """

    trigger: Rows
    place: Rows
    stamp: Stamps
    value: Array


@dataclass(frozen=True)
class Triggers:
    """Every comparison of a stretch in its order, each array (triggers,).

    ``place`` where in the stretch it happens; ``now`` the newest stamp heard; ``followed``, ``settled`` and
    ``estimated`` the stamps (ns) up to which motion, power and estimated length are known; 0: not yet.
    """

    place: Rows
    now: Stamps
    followed: Stamps
    settled: Stamps
    estimated: Stamps

    def judge(
        self, signal: Signal, known: Stamps, ready: Stamps, forgotten: Stamps
    ) -> Observations:
        """Those observations whose time comes.

        Args:
            known: stamps (ns, ascending) of what they are compared with; none is before the first.
            ready: up to where that is known at each comparison, ns, shape (triggers,).
            forgotten: up to where the twin need not remember it any more, the same.

        Raises:
            Irregular: the twin may not remember what to compare one with.
        """
        earliest = np.searchsorted(self.place, signal.place)
        trigger = np.maximum(earliest, np.searchsorted(ready, signal.stamp))
        last = np.append(self.now, 0)[np.maximum(trigger, 1) - 1]
        given_up = (trigger > earliest) & (last - signal.stamp > CLOSE_S * NANOSECONDS)
        before = np.searchsorted(known, signal.stamp, side="right") - 1
        seen = (trigger < len(self.place)) & (before >= 0) & ~given_up
        judged = only(Observations(trigger, signal.place, signal.stamp, signal.value), seen)
        if (known[before[seen]] <= forgotten[judged.trigger]).any():
            raise Irregular
        return judged


def triggers(looks: Rows, now: Stamps, motion: Motion | None, estimates: Estimates) -> Triggers:
    """Every flush, and every sample of tracker and power (``looks``); ``now`` (places + 1,)."""
    happens = np.zeros(len(now), np.bool_)
    happens[looks] = True
    if motion is not None:
        happens[motion.drive.flush_place] = True
    place = np.flatnonzero(happens)
    followed, settled = np.zeros((2, len(place)), np.int64)
    if motion is not None:
        drive = motion.drive
        at = np.append(drive.place[0], drive.flush_place)
        newest = np.searchsorted(at, place, side="right") - 1
        followed = drive.stamp[np.append(0, drive.flush_row)][newest]
        settled = drive.stamp[np.append(0, motion.settled)][newest]
        followed, settled = (np.where(newest < 0, 0, known) for known in (followed, settled))
    heard = np.searchsorted(estimates.place, place, side="right")
    estimated = np.append(0, estimates.stamp)[heard]
    return Triggers(place, now[place], followed, settled, estimated)


def judge_lengths(
    found: Triggers, estimates: Estimates, measured: Signal, settings: TwinSettings
) -> tuple[Observations, Array]:
    """(measured lengths that the command was still there for, the estimated ΔL in m)."""
    heard = np.searchsorted(estimates.place, measured.place)
    last = np.append(0, estimates.stamp)[heard]
    stale = round(settings.measured_stale_s * NANOSECONDS)
    near = (heard > 0) & (measured.stamp <= last + stale)
    forgotten = found.estimated - round(HISTORY_S * NANOSECONDS)
    judged = found.judge(only(measured, near), estimates.stamp, found.estimated, forgotten)
    if not len(judged.stamp):
        return judged, np.empty(0)
    return judged, _at(judged.stamp, estimates.stamp, estimates.length_change)


def predicted_positions(motion: Motion, stamp: Stamps) -> Array:
    """x1 (m) in the twin's own frame."""
    return _at(stamp, motion.drive.stamp, motion.columns["x1"])


def predicted_power(motion: Motion, stamp: Stamps) -> tuple[Array, Array]:
    """(power in W, energy in J since the start), as settled."""
    drive = motion.drive
    row = np.maximum(np.searchsorted(drive.stamp, stamp) - 1, 0)
    power = _at(stamp, drive.stamp, motion.final_power)
    elapsed = (stamp - drive.stamp[row]) / NANOSECONDS
    energy = motion.final_energy[row] + 0.5 * (motion.final_power[row] + power) * elapsed
    return power, energy


def measured_energy(start_ns: int, stamp: Stamps, power: Array) -> Array:
    """J since a stamp (ns), by trapezoids; the first sample after it counts from there on."""
    spent = np.zeros(len(stamp))
    later = stamp > start_ns
    values = np.append(power[later][:1], power[later])
    time = np.append(0.0, (stamp[later] - start_ns) / NANOSECONDS)
    spent[later] = accumulated(time, values)[1:]
    return spent


def _at(stamp: Stamps, known: Stamps, value: Array) -> Array:
    zero = known[0]
    found: Array = np.interp(stamp - zero, known - zero, value)
    return found


def accept(before: Sight, seen: Observations, settings: TwinSettings) -> tuple[Sight, Mask]:
    """(the sight in the end, which positions can be), as `worm_model.twin.observations.look` has it.

    Raises:
        Irregular: refused positions stay, so the tracker was moved.
    """
    stamp, value = np.append(before.stamp_ns, seen.stamp), np.append(before.position, seen.value)
    elapsed = np.maximum(np.diff(stamp), 0) / NANOSECONDS
    reach = settings.tracker_gate_m + TOP_SPEED * elapsed
    accepted = ~(np.abs(np.diff(value)) > reach)
    if accepted.all():
        last = Sight(int(stamp[-1]), float(value[-1]))
        return (last if len(accepted) else before), accepted
    sight = before
    for row, sample in enumerate(zip(seen.stamp.tolist(), seen.value.tolist(), strict=True)):
        sight, accepted[row] = look(sight, TrackerSample(*sample, math.nan), settings)
        if not accepted[row] and stays(sight, sample[0], settings):
            raise Irregular
    return sight, accepted
