# SPDX-License-Identifier: Apache-2.0
"""The twin's motion and energy under the driving length, and its recent past.

Motion follows straight lines between the driving samples, which it hardly notices (no derivative enters it).
Power does need the rate of the length (eq:Fc, eq:power_model): of an estimated length it is exact; of a
measured one it is the slope of a parabola through a window of samples, of the last ``2·smoothing_s`` while
the sample is new and of ``± smoothing_s`` around it once those samples have come. Energy is the trapezoid sum of
the settled powers, with the new ones added provisionally.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from worm_model.parameters import Parameters
from worm_model.simulation.simulator import Locomotion, LocomotionState, Motions
from worm_model.simulation.smoothing import FEWEST_SAMPLES, smooth
from worm_model.twin.records import NANOSECONDS, LengthSource

Array = NDArray[np.float64]

WINDOW_SAMPLES = 64  # that a window needs at most; of denser lengths it takes every so-many-th
SETTLE_STEP_S = 0.02  # of measured length that is settled at once, at least
HISTORY_S = 1.0  # of the past that late observations may ask for


class Knot(NamedTuple):
    """A driving sample: ΔL in m, its exact rate in m/s if the source is ESTIMATED, else NaN."""

    stamp_ns: int
    length_change: float
    rate: float
    source: LengthSource


class Row(NamedTuple):
    """The twin at a driving sample, in its own frame (origin: the rear groove at the run's start), SI.

    ``chord_rate`` is the slope of the line that ended here, ``chord_force`` F_c with it; ``rate`` and
    ``power`` are provisional until settled; the grooves are whole numbers; ``energy`` is the sum of the
    provisional powers.
    """

    knot: Knot
    x1: float
    x2: float
    y_rate: float
    rear_force: float
    front_force: float
    rear_groove: float
    front_groove: float
    chord_rate: float
    chord_force: float
    rate: float
    power: float
    energy: float

    @property
    def stamp_ns(self) -> int:
        """Stamp of the driving sample."""
        return self.knot.stamp_ns


class Settled(NamedTuple):
    """Final power (W) and energy (J since the run's start) at a stamp."""

    stamp_ns: int
    power: float
    energy: float


@dataclass(frozen=True)
class Track:
    """Motion at the newest driving sample and the recent past.

    ``motion.time`` is in s since ``zero_ns``; ``rows`` of the last second; ``settled`` the same of final
    powers; ``unsettled`` the number of the newest rows without one.
    """

    zero_ns: int
    motion: LocomotionState
    rows: tuple[Row, ...]
    settled: tuple[Settled, ...]
    unsettled: int = 0

    @property
    def stamp_ns(self) -> int:
        """Stamp of the newest row."""
        return self.rows[-1].stamp_ns

    @property
    def energy(self) -> float:
        """J since the run's start up to the newest row, the part after the last settled one provisional."""
        fresh = self.rows[-1].energy - self.rows[-1 - self.unsettled].energy
        return self.settled[-1].energy + fresh


def start_track(knot: Knot, motion: LocomotionState, model: Locomotion) -> Track:
    """A track that starts at a knot with a motion at rest, whose time is 0; so does a length without a rate."""
    instant = motion.time + 1.0 / NANOSECONDS  # the kernel tells nothing of no time at all
    _, motions = model.follow(motion, [instant], [motion.length_change])
    row = _rows([knot], motions, np.nan_to_num([knot.rate]), model.parameters)[0]
    return Track(knot.stamp_ns, motion, (row,), (Settled(knot.stamp_ns, row.power, 0.0),))


def follow(track: Track, knots: Sequence[Knot], model: Locomotion, smoothing_s: float) -> Track:
    """The track after driving samples whose stamps ascend from its own.

    Raises `worm_model.simulation.simulator.SimulationError` on chatter.
    """
    times = [(knot.stamp_ns - track.zero_ns) / NANOSECONDS for knot in knots]
    motion, motions = model.follow(track.motion, times, [knot.length_change for knot in knots])
    rates = _provisional_rates(track, knots, motions.length_rate, smoothing_s)
    rows = track.rows + tuple(_rows(knots, motions, rates, model.parameters, track.rows[-1]))
    moved = replace(track, motion=motion, rows=rows, unsettled=track.unsettled + len(knots))
    return _forget(_settle(moved, model.parameters, smoothing_s), smoothing_s)


def positions_at(track: Track, stamp_ns: int) -> tuple[float, float, float] | None:
    """(x1, x2, ΔL) in m at a stamp, None outside the remembered rows.

    Linear between rows, whose spacing is that of the driving samples.
    """
    rows = track.rows
    k = bisect_left(rows, stamp_ns, key=_row_stamp)
    if k == len(rows) or (k == 0 and rows[0].stamp_ns != stamp_ns):
        return None
    after = rows[k]
    if after.stamp_ns == stamp_ns:
        return after.x1, after.x2, after.knot.length_change
    before = rows[k - 1]
    share = (stamp_ns - before.stamp_ns) / (after.stamp_ns - before.stamp_ns)
    x1, x2 = (
        (1.0 - share) * start + share * end
        for start, end in ((before.x1, after.x1), (before.x2, after.x2))
    )
    change = before.knot.length_change
    return x1, x2, change + share * (after.knot.length_change - change)


def power_at(track: Track, stamp_ns: int) -> tuple[float, float] | None:
    """(power in W, energy in J since the start) at a stamp, final; None where there is none (yet)."""
    settled = track.settled
    k = bisect_left(settled, stamp_ns, key=_settled_stamp)
    if k == len(settled) or (k == 0 and settled[0].stamp_ns != stamp_ns):
        return None
    after = settled[k]
    if after.stamp_ns == stamp_ns:
        return after.power, after.energy
    before = settled[k - 1]
    elapsed = (stamp_ns - before.stamp_ns) / NANOSECONDS
    share = (stamp_ns - before.stamp_ns) / (after.stamp_ns - before.stamp_ns)
    power = before.power + share * (after.power - before.power)
    return power, before.energy + 0.5 * (before.power + power) * elapsed


def _row_stamp(row: Row) -> int:
    return row.knot.stamp_ns


def _settled_stamp(item: Settled) -> int:
    return item.stamp_ns


def _rows(
    knots: Sequence[Knot],
    motions: Motions,
    rates: Array,
    parameters: Parameters,
    before: Row | None = None,
) -> list[Row]:
    mu = parameters.front_mass / parameters.mass
    columns = [
        motions.x1,
        motions.x2,
        motions.v1 + mu * motions.length_rate,
        motions.rear_force,
        motions.front_force,
        motions.rear_groove,
        motions.front_groove,
        motions.length_rate,
        motions.cable_force,
        rates,
        power_at_rate(motions.cable_force, motions.length_rate, rates, parameters),
    ]
    rows: list[Row] = []
    for knot, line in zip(knots, np.array(columns).T.tolist(), strict=True):
        power, energy = line[-1], 0.0
        if before is not None:
            step = (knot.stamp_ns - before.knot.stamp_ns) / NANOSECONDS
            energy = before.energy + 0.5 * (before.power + power) * step
        before = Row._make((knot, *line, energy))
        rows.append(before)
    return rows


def force_at_rate(chord_force: Any, chord_rate: Any, rate: Any, parameters: Parameters) -> Any:
    """F_c in N (eq:Fc) at another length rate than the chord's; ẏ and the fin forces do not depend on it.

    Left out is the share of L̈ in M1·ẍ1, at most 0.1 N in the gaits of the paper's box.
    """
    mu = parameters.front_mass / parameters.mass
    drag = parameters.bellows_damping + parameters.viscous_friction * mu
    return chord_force - drag * (rate - chord_rate)


def power_at_rate(chord_force: Any, chord_rate: Any, rate: Any, parameters: Parameters) -> Any:
    """Source power in W (eq:power_model) at another length rate than the chord's."""
    force = force_at_rate(chord_force, chord_rate, rate, parameters)
    return parameters.idle_power + parameters.power_factor * np.maximum(-force * rate, 0.0)


def _provisional_rates(
    track: Track, knots: Sequence[Knot], chords: Array, smoothing_s: float
) -> Array:
    """Rates in m/s that are known at once: exact, or from the past alone (with too little of it, the chord's)."""
    rates = np.array([knot.rate for knot in knots])
    rates = np.where(np.isfinite(rates), rates, chords)
    last = knots[-1]
    if last.source is LengthSource.MEASURED:
        # What is published is the newest; the others differ by less than the filter resolves.
        past = _measured_rows(track.rows, last.stamp_ns - round(2.0 * smoothing_s * NANOSECONDS))
        known = [*past, *(knot for knot in knots if knot.source is LengthSource.MEASURED)]
        newest = _slopes(known, [last.stamp_ns], 2.0 * smoothing_s, 0.0, rates[-1:])
        measured = [knot.source is LengthSource.MEASURED for knot in knots]
        rates = np.where(measured, newest, rates)
    return rates


def _measured_rows(rows: Sequence[Row], since_ns: int) -> list[Knot]:
    first = bisect_left(rows, since_ns, key=_row_stamp)
    return [row.knot for row in rows[first:] if row.knot.source is LengthSource.MEASURED]


def _slopes(
    known: Sequence[Knot], at: Sequence[int], before: float, after: float, default: Array
) -> Array:
    """Slopes of the known lengths at stamps (ns), the default where samples are too few."""
    zero = at[0]
    if len(known) < FEWEST_SAMPLES:
        return default
    span = (known[-1].stamp_ns - known[0].stamp_ns) / NANOSECONDS
    known = known[:: max(1, int(len(known) * (before + after) / max(span, 1e-9) / WINDOW_SAMPLES))]
    times = [(knot.stamp_ns - zero) / NANOSECONDS for knot in known]
    targets = [(stamp - zero) / NANOSECONDS for stamp in at]
    fitted = smooth(times, [knot.length_change for knot in known], targets, before, after).rate
    return np.where(np.isfinite(fitted), fitted, default)


def _settle(track: Track, parameters: Parameters, smoothing_s: float) -> Track:
    """Finishes the rows that can be: estimated lengths at once, measured ones when their window is full."""
    pending = track.rows[len(track.rows) - track.unsettled :]
    limit = track.stamp_ns - round(smoothing_s * NANOSECONDS)
    ready = 0
    for row in pending:
        if row.knot.source is LengthSource.MEASURED and row.stamp_ns > limit:
            break
        ready += 1
    if not ready or not _worth_settling(pending, ready):
        return track
    chosen = pending[:ready]
    rates = np.array([row.rate for row in chosen])
    measured = [k for k, row in enumerate(chosen) if row.knot.source is LengthSource.MEASURED]
    if measured:
        at = [chosen[k].stamp_ns for k in measured]
        known = _measured_rows(track.rows, at[0] - round(smoothing_s * NANOSECONDS))
        rates[measured] = _slopes(known, at, smoothing_s, smoothing_s, rates[measured])
    force = np.array([row.chord_force for row in chosen])
    slope = np.array([row.chord_rate for row in chosen])
    settled = list(track.settled)
    for row, power in zip(
        chosen, power_at_rate(force, slope, rates, parameters).tolist(), strict=True
    ):
        last = settled[-1]
        step = (row.stamp_ns - last.stamp_ns) / NANOSECONDS
        energy = last.energy + 0.5 * (last.power + power) * step
        settled.append(Settled(row.stamp_ns, power, energy))
    return replace(track, settled=tuple(settled), unsettled=track.unsettled - ready)


def _worth_settling(pending: Sequence[Row], ready: int) -> bool:
    if ready == len(pending):
        return True
    span = pending[ready].stamp_ns - pending[0].stamp_ns
    return span >= SETTLE_STEP_S * NANOSECONDS


def remembered_ns(smoothing_s: float) -> int:
    """How far back (ns) from its newest row a track remembers at least."""
    window_s = 2.0 * smoothing_s + SETTLE_STEP_S  # around the oldest row that is not settled yet
    return round(max(HISTORY_S, window_s) * NANOSECONDS)


def _forget(track: Track, smoothing_s: float) -> Track:
    """Drops what no late observation and no window asks for any more, in pieces."""
    limit = track.stamp_ns - remembered_ns(smoothing_s)
    if track.rows[0].stamp_ns > limit - NANOSECONDS // 4:
        return track
    keep = (
        len(track.rows) - 1 - track.unsettled
    )  # after a pause, rows without a final power may be old
    rows = track.rows[min(bisect_right(track.rows, limit, key=_row_stamp), keep) :]
    first = min(bisect_right(track.settled, limit, key=_settled_stamp), len(track.settled) - 1)
    return replace(track, rows=rows, settled=track.settled[first:])
