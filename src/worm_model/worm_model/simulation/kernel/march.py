# SPDX-License-Identifier: Apache-2.0
"""March through the modes of one segment of the length signal, from event to event.

Rules of the events:

- An event happens at the end of a half-open interval (t0, t1], when a fin passes a border of its region.
- Of two simultaneous events, the event of the rear fin (A1) comes first. The event of the front fin follows in a mode
  of zero duration.
- A fin that touches a border without passing it triggers nothing.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from worm_model.simulation.kernel import guard
from worm_model.simulation.kernel.compiled import compiled, inlined
from worm_model.simulation.kernel.dry_friction import (
    Grip,
    enter_dry_mode,
    locate_grip,
    look_for_grip,
)
from worm_model.simulation.kernel.grooves import Grooves, in_grooves
from worm_model.simulation.kernel.linear import (
    Basis,
    Coefficients,
    Wave,
    basis_at,
    basis_at_start,
    derivative,
    roots_of,
    value,
)
from worm_model.simulation.kernel.mode import (
    ABOVE,
    BELOW,
    CLEAR,
    Constants,
    Fin,
    Mode,
    Motion,
    cable_force,
    enter_mode,
    fin_stiffness,
    moved,
    region_of,
)
from worm_model.simulation.kernel.work import cable_power_of, cable_work

POSITION_TOLERANCE = 1e-14  # m; accuracy with which a border is located
# N for F_c, m/s for L̇; below it the sign of the quantity is irrelevant, because the power is almost zero
SIGN_TOLERANCE = 1e-9
TIME_ROUNDING = 1e-14  # relative; a sample that is later than the end of a mode by at most this belongs to the mode
MOST_STEPS = 20_000  # steps in a segment; if they are not sufficient, the march reports CHATTERS

# Columns of a row of samples
(
    TIME,
    X1,
    X2,
    V1,
    V2,
    LENGTH_CHANGE,
    LENGTH_RATE,
    FORCE,
    REAR_FORCE,
    FRONT_FORCE,
    WORK,
    REAR_GROOVE,
    FRONT_GROOVE,
) = range(13)
SAMPLE_COLUMNS = 13
# Columns of a row of events; the guard's number encodes the fin and the direction
EVENT_TIME, EVENT_GUARD, EVENT_SWITCHED = range(3)
EVENT_COLUMNS = 3
# Entries of the totals
WORK_DONE, SWITCHES, STEPS, SAMPLED, EVENTS, FAILURE = range(6)
TOTALS_SIZE = 6
CHATTERS = 1.0  # in the entry FAILURE: MOST_STEPS are not sufficient, so a fin probably chatters


class Records(NamedTuple):
    """Arrays that a run fills.

    Attributes:
        totals: (TOTALS_SIZE,); accumulates the positive cable work in J (not for a sampled length, whose rate is not
            usable), the number of switches, the number of filled rows of ``samples``, and the number of events. The
            entry STEPS counts the steps of the present segment. The entry FAILURE becomes CHATTERS if a segment needs
            more than MOST_STEPS.
        samples: (n, SAMPLE_COLUMNS); the column TIME contains the times of the rows, ascending, s.
        events: (m, EVENT_COLUMNS); if there are more than m events, the others are only counted.
    """

    totals: np.ndarray
    samples: np.ndarray
    events: np.ndarray


class Segment(NamedTuple):
    """Piece of the length signal: start (s since the run's start), duration (s), ΔL, and the functions' parameters."""

    start: float
    duration: float
    length_change: Coefficients
    wave: Wave


class Stage(NamedTuple):
    """Mode with the quantities that are watched for its events.

    ``offset`` is the start of the mode in its segment, s. ``rear`` and ``front`` are the displacements of the fins, and
    ``rear_low`` to ``front_high`` the displacements at which the fins leave their regions, m. ``force`` is F_c.
    ``grip`` has no meaning without dry friction.
    """

    offset: float
    mode: Mode
    grip: Grip
    rear: guard.Followed
    front: guard.Followed
    force: guard.Followed
    length_rate: guard.Followed
    rear_low: float
    rear_high: float
    front_low: float
    front_high: float


class PositiveWork(NamedTuple):
    """State of the integration of the positive cable work, over a time in which F_c and L̇ keep their signs.

    ``force_side`` and ``rate_side`` are these signs. ``active`` is True if the power of the cable is positive. ``mark``
    is the antiderivative (`work.cable_work`) at the start of this time, J.
    """

    force_side: float
    rate_side: float
    active: bool
    mark: float


@inlined
def is_dry(c: Constants) -> bool:
    """Return True if a module has dry friction."""
    return c.resistance.rear_dry + c.resistance.front_dry > 0.0


@inlined
def _borders(region: int, fin: Fin, half_clearance: float) -> tuple[float, float]:
    """Return the displacements at which a fin leaves its region."""
    if region == CLEAR:
        return -half_clearance, half_clearance
    if region == BELOW:
        return -fin.threshold, -half_clearance
    return half_clearance, fin.threshold


@inlined
def _open_stage(motion: Motion, segment: Segment, offset: float, b: Basis, c: Constants) -> Stage:
    wave = segment.wave
    if is_dry(c):
        mode, force, grip = enter_dry_mode(motion, segment.length_change, wave, c, b)
    else:
        mode = enter_mode(motion, segment.length_change, wave, c, b, 0.0)
        force, grip = cable_force(mode, motion.rear_region, wave, c), Grip(0, 0)
    rear_low, rear_high = _borders(motion.rear_region, c.rear_fin, c.body.half_clearance)
    front_low, front_high = _borders(motion.front_region, c.front_fin, c.body.half_clearance)
    return Stage(
        offset,
        mode,
        grip,
        guard.follow(mode.rear, mode.roots, wave),
        guard.follow(mode.front, mode.roots, wave),
        guard.follow(force, mode.roots, wave),
        guard.follow(derivative(segment.length_change, mode.roots, wave), mode.roots, wave),
        rear_low,
        rear_high,
        front_low,
        front_high,
    )


@inlined
def _look_ahead(
    stage: Stage,
    work: PositiveWork,
    motion: Motion,
    b: Basis,
    s: float,
    left: float,
    wave: Wave,
    c: Constants,
) -> guard.Horizon:
    """Return the bounds on the next event within the remaining ``left`` seconds of the segment."""
    roots = stage.mode.roots
    coarse = roots.joined or stage.mode.resonant
    ahead = guard.Horizon(left, left, guard.END)
    rear = guard.read(stage.rear, b, s, left, roots, wave, coarse)
    ahead = guard.narrow(ahead, guard.below(rear, stage.rear_high), guard.REAR_HIGH)
    ahead = guard.narrow(ahead, guard.above(rear, stage.rear_low), guard.REAR_LOW)
    front = guard.read(stage.front, b, s, left, roots, wave, coarse)
    ahead = guard.narrow(ahead, guard.below(front, stage.front_high), guard.FRONT_HIGH)
    ahead = guard.narrow(ahead, guard.above(front, stage.front_low), guard.FRONT_LOW)
    if wave.q != 0.0:
        force = guard.read(stage.force, b, s, left, roots, wave, coarse)
        gap = guard.above(force, 0.0) if work.force_side > 0.0 else guard.below(force, 0.0)
        ahead = guard.narrow(ahead, gap, guard.FORCE_SIGN)
    length_rate = stage.length_rate.position
    polynomial = length_rate.one != 0.0 or length_rate.t1 != 0.0
    # Otherwise L̇ decays exponentially and keeps its sign, or the length is sampled and no work is integrated.
    if wave.omega != 0.0 or (wave.q != 0.0 and polynomial):
        rate = guard.read(stage.length_rate, b, s, left, roots, wave, coarse)
        gap = guard.above(rate, 0.0) if work.rate_side > 0.0 else guard.below(rate, 0.0)
        ahead = guard.narrow(ahead, gap, guard.RATE_SIGN)
    if is_dry(c):
        ahead = look_for_grip(ahead, stage.mode, stage.grip, motion, b, s, left, wave, c)
    return ahead


@inlined
def _go(
    stage: Stage,
    ahead: guard.Horizon,
    motion: Motion,
    s: float,
    b: Basis,
    wave: Wave,
    c: Constants,
) -> tuple[float, Basis]:
    """Return (time in the mode in s, basis) of the next event, or of the point from which the search continues."""
    mode, offset = stage.mode, stage.offset
    if ahead.stop == guard.NOTHING or ahead.stop == guard.END:
        s += max(ahead.time, guard.SHORTEST_STEP) if ahead.stop == guard.NOTHING else ahead.time
        return s, basis_at(offset + s, s, mode.roots, wave, mode.resonant)
    if ahead.stop > guard.END:
        return locate_grip(ahead, mode, stage.grip, motion, b, s, offset, wave, c)
    followed, border, tolerance = stage.rear, stage.rear_high, POSITION_TOLERANCE
    if ahead.stop == guard.REAR_LOW:
        border = stage.rear_low
    elif ahead.stop == guard.FRONT_HIGH:
        followed, border = stage.front, stage.front_high
    elif ahead.stop == guard.FRONT_LOW:
        followed, border = stage.front, stage.front_low
    elif ahead.stop == guard.FORCE_SIGN:
        followed, border, tolerance = stage.force, 0.0, SIGN_TOLERANCE
    elif ahead.stop == guard.RATE_SIGN:
        followed, border, tolerance = stage.length_rate, 0.0, SIGN_TOLERANCE
    return guard.locate(
        followed, border, tolerance, s, b, ahead, offset, mode.roots, wave, mode.resonant
    )


@inlined
def _side(quantity: guard.Followed, b: Basis) -> float:
    """Return the sign of a quantity from now on: that of its value, or that of its rate if the value is almost zero."""
    here = value(quantity.position, b)
    if abs(here) <= SIGN_TOLERANCE:
        here = value(quantity.rate, b)
    return -1.0 if here < 0.0 else 1.0


@inlined
def _antiderivative(stage: Stage, b: Basis, wave: Wave) -> float:
    return cable_work(
        stage.mode.length_change,
        stage.length_rate.position,
        stage.force.position,
        b,
        b.t1 - stage.offset,
        wave,
        stage.mode.roots,
    )


@inlined
def _open_work(
    force_side: float, rate_side: float, stage: Stage, b: Basis, wave: Wave, c: Constants
) -> PositiveWork:
    active = wave.q != 0.0 and cable_power_of(force_side, rate_side, c.body.one_sided_cable) > 0.0
    mark = _antiderivative(stage, b, wave) if active else 0.0
    return PositiveWork(force_side, rate_side, active, mark)


@inlined
def _crossed(motion: Motion, stop: int, y: float, y_rate: float, c: Constants) -> Motion:
    """Return the motion after a fin has left its region for the neighbouring one or the next groove (eq:A1_switch)."""
    front = stop in (guard.FRONT_HIGH, guard.FRONT_LOW)
    direction = 1 if stop in (guard.REAR_HIGH, guard.FRONT_HIGH) else -1
    region = motion.front_region if front else motion.rear_region
    groove = motion.front_groove if front else motion.rear_groove
    threshold = c.front_fin.threshold if front else c.rear_fin.threshold
    if region == CLEAR:
        region = ABOVE if direction > 0 else BELOW
    elif (region == ABOVE) == (direction > 0):
        groove += direction
        region = region_of(direction * (threshold - c.body.pitch), c.body.half_clearance)
    elif c.body.half_clearance > 0.0:
        region = CLEAR
    else:  # Without clearance there is no region CLEAR: a fin could enter and leave it endlessly.
        region = ABOVE if direction > 0 else BELOW
    if front:
        return Motion(y, y_rate, motion.rear_groove, groove, motion.rear_region, region)
    return Motion(y, y_rate, groove, motion.front_groove, region, motion.front_region)


@compiled
def _write_sample(
    row: np.ndarray, stage: Stage, motion: Motion, b: Basis, wave: Wave, c: Constants
) -> None:
    """Fill a row of samples, except for the columns TIME and WORK."""
    mode = stage.mode
    length_change, length_rate = value(mode.length_change, b), value(stage.length_rate.position, b)
    rear, front = value(mode.rear, b), value(mode.front, b)
    x1_rate = value(derivative(mode.y, mode.roots, wave), b) - c.body.mu * length_rate
    row[X1] = rear + motion.rear_groove * c.body.pitch
    row[X2] = front + motion.front_groove * c.body.pitch
    row[V1] = x1_rate
    row[V2] = x1_rate + length_rate
    row[LENGTH_CHANGE] = length_change
    row[LENGTH_RATE] = length_rate
    row[FORCE] = value(stage.force.position, b)
    row[REAR_FORCE] = fin_stiffness(motion.rear_region, c.rear_fin) * (
        rear - (motion.rear_region - 1.0) * c.body.half_clearance
    )
    row[FRONT_FORCE] = fin_stiffness(motion.front_region, c.front_fin) * (
        front - (motion.front_region - 1.0) * c.body.half_clearance
    )
    row[REAR_GROOVE] = motion.rear_groove
    row[FRONT_GROOVE] = motion.front_groove


@compiled
def _write_samples(
    until: float,
    stage: Stage,
    work: PositiveWork,
    segment: Segment,
    motion: Motion,
    c: Constants,
    records: Records,
) -> None:
    """Fill the rows whose times are at most ``until`` seconds after the start of the mode."""
    totals, samples = records.totals, records.samples
    start = segment.start + stage.offset
    end = (start + until) * (1.0 + TIME_ROUNDING)
    at = int(totals[SAMPLED])
    while at < samples.shape[0] and samples[at, TIME] <= end:
        s = min(max(samples[at, TIME] - start, 0.0), until)
        b = basis_at(stage.offset + s, s, stage.mode.roots, segment.wave, stage.mode.resonant)
        _write_sample(samples[at], stage, motion, b, segment.wave, c)
        samples[at, WORK] = totals[WORK_DONE]
        if work.active:
            samples[at, WORK] += work.mark - _antiderivative(stage, b, segment.wave)
        at += 1
    totals[SAMPLED] = at


@compiled
def _write_event(time: float, stop: int, switched: bool, records: Records) -> None:
    totals, events = records.totals, records.events
    at = int(totals[EVENTS])
    if at < events.shape[0]:
        events[at, EVENT_TIME] = time
        events[at, EVENT_GUARD] = stop
        events[at, EVENT_SWITCHED] = 1.0 if switched else 0.0
    totals[EVENTS] = at + 1
    totals[SWITCHES] += 1.0 if switched else 0.0


@inlined
def _follow_mode(
    stage: Stage, b: Basis, segment: Segment, motion: Motion, c: Constants, records: Records
) -> tuple[float, int, Basis]:
    """Follow a mode to its end.

    Returns:
        Duration of the mode, the guard that ends it (NOTHING beyond MOST_STEPS), and the basis at the end.
    """
    wave, totals = segment.wave, records.totals
    work = _open_work(_side(stage.force, b), _side(stage.length_rate, b), stage, b, wave, c)
    s = 0.0
    while True:
        totals[STEPS] += 1.0
        left = segment.duration - stage.offset - s
        ahead = _look_ahead(stage, work, motion, b, s, left, wave, c)
        s, b = _go(stage, ahead, motion, s, b, wave, c)
        if ahead.stop == guard.NOTHING and totals[STEPS] <= MOST_STEPS:
            continue
        if totals[SAMPLED] < records.samples.shape[0]:
            _write_samples(s, stage, work, segment, motion, c, records)
        if work.active:
            totals[WORK_DONE] += work.mark - _antiderivative(stage, b, wave)
        if totals[STEPS] > MOST_STEPS and ahead.stop != guard.END:
            return s, guard.NOTHING, b
        if ahead.stop == guard.FORCE_SIGN:
            work = _open_work(-work.force_side, work.rate_side, stage, b, wave, c)
        elif ahead.stop == guard.RATE_SIGN:
            work = _open_work(work.force_side, -work.rate_side, stage, b, wave, c)
        else:
            return s, ahead.stop, b


@inlined
def march(
    segment: Segment, motion: Motion, even: Constants, grooves: Grooves | None, records: Records
) -> Motion:
    """Return the motion at the end of a segment.

    The motion does not state which module sticks, because this is determined at the start of each mode.

    Args:
        segment: piece of the length signal.
        motion: motion at the start of the segment.
        even: constants of the robot in even grooves.
        grooves: individual grooves; None for even grooves.
        records: arrays that are filled.
    """
    c = even if grooves is None else in_grooves(even, motion, grooves)
    records.totals[STEPS] = 0.0
    b = basis_at(0.0, 0.0, roots_of(c.body.mass, c.body.friction, 0.0), segment.wave, False)
    offset = 0.0
    while True:
        stage = _open_stage(motion, segment, offset, b, c)
        b = basis_at_start(b, stage.mode.roots)
        duration, stop, b = _follow_mode(stage, b, segment, motion, c, records)
        offset += duration
        y = value(stage.mode.y, b)
        y_rate = value(derivative(stage.mode.y, stage.mode.roots, segment.wave), b)
        if stop in (guard.END, guard.NOTHING) or stop > guard.END:
            motion = moved(motion, y, y_rate)
            if stop > guard.END:
                continue
            if stop == guard.NOTHING:
                records.totals[FAILURE] = CHATTERS
            return motion
        passed = motion.rear_groove + motion.front_groove
        motion = _crossed(motion, stop, y, y_rate, c)
        switched = motion.rear_groove + motion.front_groove != passed
        if grooves is not None:
            c = in_grooves(even, motion, grooves)
        _write_event(segment.start + offset, stop, switched, records)
