# SPDX-License-Identifier: Apache-2.0
"""Estimation of motion, power and residuals from sample to sample, and of the ΔL that follows from the command.

Samples are processed in the order of their stamps, once they are older than the newest sample by the delay plus
`LOOK_AHEAD_NS`.

- The **answer** to the command is the ΔL that the actuation model computes from the command, exactly at each stamp
  (`worm_model.simulation.kernel.actuation_law`).
- The **driving length** is interpolated linearly between measured lengths. Between two measured lengths that are more
  than `LOOK_AHEAD_NS` apart, it is the answer to the command. The look-ahead makes this choice possible.
- The **motion** is computed exactly from the driving length, without a derivative of a measured length.
- The **power** depends on the length's rate (eq:Fc, eq:power_model). The rate of the answer is exact. For measured
  lengths, a parabola is fitted to their differences from the answer within ± `SMOOTHING_S`. Its slope is added to the
  rate of the answer, so that only the small differences are smoothed. The power contains the square of the rate. The
  noise of the rate therefore adds a bias to the power, which is subtracted.
- The **energy** is the trapezoidal sum of the power.
- The measurements are **compared** with the twin (`judge`).

The motion does not advance beyond the last known driving length. Positions and powers after it are not compared.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from worm_model.run import LengthSource
from worm_model.simulation.kernel import march
from worm_model.simulation.kernel.actuation_law import (
    Actuator,
    answer_to_line,
    crossing,
    effective,
    respond,
    value_at,
)
from worm_model.simulation.kernel.compiled import entry, unlocked
from worm_model.simulation.kernel.linear import Coefficients, Wave
from worm_model.simulation.kernel.mode import Constants, Motion, nearest_groove_of, region_of
from worm_model.simulation.kernel.whole_run import step
from worm_model.simulation.kernel.work import cable_power_of
from worm_model.twin.core.memory import (
    COMMAND_KIND,
    GAIT_KIND,
    LENGTH_KIND,
    LOOK_AHEAD_NS,
    NANOSECONDS,
    POSITION_KIND,
    SMOOTHING_NS,
    SMOOTHING_S,
    Memory,
    OutputRows,
)
from worm_model.twin.core.memory import LENGTH as LENGTH_CHANNEL
from worm_model.twin.core.residuals import judge

SECONDS_PER_NS = 1e-9  # s per ns
MOVED_M = 1e-6  # m, commanded contraction above which a run has begun, even without a driver state
PULLED_M = 5e-4  # m, commanded contraction above which the cable counts as pulled
FEWEST_LENGTHS = 4  # fewest lengths of a fit; a parabola through three would follow their noise
PAUSE_NS = NANOSECONDS  # a longer time without measured lengths and commands is reported as a gap
# Shortest interval of published states and of estimated lengths. It is shorter than the driver's period of 10 ms by
# more than the period's jitter, so that each command yields a state.
PERIOD_NS = 8_000_000
ESTIMATED, MEASURED = int(LengthSource.ESTIMATED), int(LengthSource.MEASURED)

# Reasons to return to the Python code: no row to process, a driver state, the end of a cycle, a run that no driver
# state has announced.
DONE, DRIVER_STATE, CYCLE_END, UNANNOUNCED_RUN = range(4)
# Events: a gap in the lengths (value: duration, s), a motion that switches endlessly (0), a moved tracker (shift, m).
GAP, ZENO, TRACKER_MOVED = range(3)


@entry
def _report(out: OutputRows, kind: int, stamp: int, value: float) -> None:
    row = out.events[out.counts[3]]
    row.kind, row.stamp_ns, row.value = kind, stamp, value
    out.counts[3] += 1


@entry
def begins(rows: np.ndarray, k: int) -> bool:
    """Return True if a row is the onset of a run. Searches for later rows end at such a row."""
    return rows[k].kind == GAIT_KIND and rows[k].onset == rows[k].stamp


@entry
def next_of(memory: Memory, kind: int, until: int) -> int:
    """Return the index of the first row of a kind after the row being processed, or −1.

    The search ends after the stamp ``until``, and at the onset of another run.
    """
    m, rows = memory.record[0], memory.rows
    k = m.place + 1
    while k < m.filled and rows[k].stamp <= until and not begins(rows, k):
        if rows[k].kind == kind:
            return k
        k += 1
    return -1


@entry
def _line(value: float, slope: float) -> Coefficients:
    # with floats only: the kernel would be compiled once more for integers
    return Coefficients(value, slope, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@entry
def _answers_ahead(memory: Memory, until: int, a: Actuator) -> None:
    """Store the answer (m) at each later measured length in the column `c` of its row, up to the stamp ``until``.

    `c` becomes NaN where the answer is unknown.
    """
    m, rows = memory.record[0], memory.rows
    when, command, answer = m.command_ns, m.command, m.answer
    k = m.place + 1
    for j in range(m.place + 1, m.filled):
        if rows[j].stamp > until or begins(rows, j):
            break
        if rows[j].kind != COMMAND_KIND or rows[j].stamp <= when:
            continue
        while k < j:
            if rows[k].kind == LENGTH_KIND:
                share = (rows[k].stamp - when) / (rows[j].stamp - when)
                there = command + share * (rows[j].a - command)
                rows[k].c = respond(
                    answer, command, there, (rows[k].stamp - when) * SECONDS_PER_NS, a
                )
            k += 1
        answer = respond(answer, command, rows[j].a, (rows[j].stamp - when) * SECONDS_PER_NS, a)
        when, command = rows[j].stamp, rows[j].a
    while k < m.filled and rows[k].stamp <= until:
        rows[k].c = math.nan if rows[k].kind == LENGTH_KIND else rows[k].c
        k += 1


@entry
def _slope(memory: Memory, stamp: int, a: Actuator) -> tuple[float, float]:
    """Return the rate (m/s) of the measured length at a stamp, and its variance (1/s²) for a noise variance of 1 m².

    The rate is the slope of a parabola fitted to the lengths around the stamp. If the answer to the command is known at
    the stamp, the parabola fits the differences from the answer, and the answer's rate is added. Otherwise the length
    at which the twin was put at rest is included. The rate is NaN if the lengths are too few, or all on one side of the
    stamp, because a parabola is not suited for extrapolation.
    """
    m, rows = memory.record[0], memory.rows
    half, window = SMOOTHING_S, SMOOTHING_NS + 1
    with_answer = m.engaged and m.answered
    if with_answer:
        _answers_ahead(memory, stamp + window, a)
    k = m.place
    while k > 0 and rows[k - 1].stamp >= max(stamp - window, m.track_ns):
        k -= 1
    n, earlier, later = 0, 0, 0
    s1, s2, s3, s4, y0, y1, y2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    at_start = m.track_ns >= stamp - window and not with_answer
    while at_start or (
        k < m.filled and rows[k].stamp <= stamp + window and not (k > m.place and begins(rows, k))
    ):
        if at_start:
            when, change = m.track_ns, m.track_change
        else:
            when, change = rows[k].stamp, rows[k].a - m.initial_length
        known = at_start or not with_answer or not math.isnan(rows[k].c)
        if known and (at_start or (rows[k].kind == LENGTH_KIND and when > m.track_ns)):
            t = (when - stamp) * SECONDS_PER_NS / half
            y = change - (rows[k].c if with_answer else m.length_change)
            n += 1
            earlier += 1 if when <= stamp else 0
            later += 1 if when >= stamp else 0
            s1 += t
            s2 += t * t
            s3 += t * t * t
            s4 += t * t * t * t
            y0 += y
            y1 += t * y
            y2 += t * t * y
        k += 0 if at_start else 1
        at_start = False
    if n < FEWEST_LENGTHS or earlier == 0 or later == 0:
        return math.nan, 0.0
    # Cramer's rule for the slope of the normal equations [n s1 s2; s1 s2 s3; s2 s3 s4].
    determinant = n * (s2 * s4 - s3 * s3) - s1 * (s1 * s4 - s2 * s3) + s2 * (s1 * s3 - s2 * s2)
    if abs(determinant) < 1e-9 * n * n * n:
        return math.nan, 0.0
    slope = n * (y1 * s4 - s3 * y2) - y0 * (s1 * s4 - s2 * s3) + s2 * (s1 * y2 - y1 * s2)
    rate = slope / determinant / half
    if with_answer:
        rate += (effective(m.command, a) - m.answer) / a.time_constant
    return rate, (n * s4 - s2 * s2) / determinant / (half * half)


@entry
def put_at_rest(
    memory: Memory, stamp: int, length_change: float, source: int, c: Constants
) -> None:
    """Put the twin at rest at a stamp, with ΔL in m and the pose that the memory contains for the run's start.

    ``source`` is the `LengthSource` of ΔL.
    """
    m = memory.record[0]
    x1 = m.pose_x1
    x2 = x1 + c.body.initial_length + length_change
    m.moving, m.source = 1, source
    m.on_estimate = 1 if source == ESTIMATED else 0
    m.motion_ns = m.track_ns = m.power_ns = stamp
    m.track_change = length_change
    m.length_change, m.y, m.y_rate = length_change, x1 + c.body.mu * length_change, 0.0
    m.rear_groove, m.front_groove = 0, m.pose_front
    m.rear_region = region_of(x1, c.body.half_clearance)
    m.front_region = region_of(x2 - m.pose_front * c.body.pitch, c.body.half_clearance)
    m.power = m.energy = 0.0
    _move(memory, _line(length_change, 0.0), SECONDS_PER_NS, 0.0, c)


@entry
def _move(memory: Memory, form: Coefficients, duration: float, q: float, c: Constants) -> None:
    """Advance the motion by a duration (s) under a ΔL of a given form; ``q`` (1/s) is the rate of its exponential.

    `Memory.sample` then contains the quantities at the end.
    """
    m = memory.record[0]
    motion = Motion(m.y, m.y_rate, m.rear_groove, m.front_groove, m.rear_region, m.front_region)
    segment = march.Segment(0.0, duration, form, Wave(c.body.mass, 0.0, q))
    motion = step(segment, motion, c, memory.totals, memory.sample)
    m.y, m.y_rate = motion.y, motion.rate
    m.rear_groove, m.front_groove = motion.rear_groove, motion.front_groove
    m.rear_region, m.front_region = motion.rear_region, motion.front_region


@entry
def _move_along(memory: Memory, stamp: int, corner: int, target: float, c: Constants) -> None:
    """Advance the motion to a stamp, with ΔL on a straight line that reaches ``target`` (m) at the stamp ``corner``."""
    m = memory.record[0]
    duration = (stamp - m.motion_ns) * SECONDS_PER_NS
    if duration <= 0.0:
        return
    slope = (target - m.length_change) / ((corner - m.motion_ns) * SECONDS_PER_NS)
    _move(memory, _line(m.length_change, slope), duration, 0.0, c)
    m.length_change = target if stamp == corner else m.length_change + slope * duration
    m.motion_ns, m.on_estimate = stamp, 0


@entry
def _move_with_answer(
    memory: Memory, stamp: int, start: float, end: float, before: float, c: Constants, a: Actuator
) -> None:
    """Advance the motion to a stamp, with the answer to a command that moves in a straight line from start to end (m).

    ``before`` is the answer (m) at the start. The motion is computed in two parts if the command crosses −δ_s.
    """
    m = memory.record[0]
    left = (stamp - m.motion_ns) * SECONDS_PER_NS
    if left <= 0.0:
        return
    q, value = -1.0 / a.time_constant, before
    if not m.engaged:
        _move(memory, _line(value, 0.0), left, 0.0, c)
    else:
        share = crossing(start, end, a)
        for part in range(2):
            last = end if part or share == 1.0 else -a.slack
            duration = left if part or share == 1.0 else share * left
            slope = (effective(last, a) - effective(start, a)) / duration
            form = answer_to_line(value, effective(start, a), slope, a)
            _move(memory, form, duration, q, c)
            value = value_at(form, duration, 0.0, a.time_constant)
            left, start = left - duration, last
            if share == 1.0 or left <= 0.0:
                break
    m.length_change, m.motion_ns, m.on_estimate = m.answer, stamp, 1


@entry
def _answer(memory: Memory, stamp: int, command: float, a: Actuator) -> None:
    """Advance the answer to a stamp, with the command on a straight line to a value in m."""
    m = memory.record[0]
    if m.engaged:
        duration = (stamp - m.command_ns) * SECONDS_PER_NS
        m.answer = respond(m.answer, m.command, command, duration, a)
    m.command_ns, m.command = stamp, command


@entry
def drag_of(c: Constants) -> float:
    """Return minus the derivative (N·s/m) of F_c with respect to L̇ at constant ẏ, where y = x1 + μ·ΔL.

    The effect of L̈ is neglected.
    """
    return c.body.bellows_damping + c.body.friction * c.body.mu


@entry
def _update_power(memory: Memory, stamp: int, c: Constants, a: Actuator, p: Any) -> float:
    """Compute power and energy at ``stamp``, up to which the motion is computed, and return L̇ in m/s."""
    m, sample = memory.record[0], memory.sample[0]
    rate, variance = math.nan, 0.0
    if not m.on_estimate:
        rate, variance = _slope(memory, stamp, a)
        variance *= m.noise_square[LENGTH_CHANNEL]
    if math.isnan(rate):
        # The slope of a line from a measured to an estimated length is not the rate of the body.
        rate = sample[march.LENGTH_RATE]
        if m.on_estimate or m.answered:
            rate = (effective(m.command, a) - m.answer) / a.time_constant if m.engaged else 0.0
    force = sample[march.FORCE] - drag_of(c) * (rate - sample[march.LENGTH_RATE])
    mechanical = cable_power_of(force, rate, c.body.one_sided_cable)
    power = p.idle_power + p.power_factor * max(mechanical - drag_of(c) * variance, 0.0)
    before = m.power if stamp > m.track_ns else power
    m.energy += 0.5 * (before + power) * (stamp - m.power_ns) * SECONDS_PER_NS
    m.power_ns, m.power = stamp, power
    m.power_variance = (p.power_factor * (drag_of(c) * rate - force)) ** 2 * variance
    return rate


@entry
def publish(memory: Memory, rate: float, c: Constants, out: OutputRows) -> None:
    """Add the state of the motion to the output; ``rate`` (m/s) is L̇."""
    m, sample = memory.record[0], memory.sample[0]
    row = out.states[out.counts[0]]
    zero = m.origin + m.moved * c.body.pitch
    front = int(nearest_groove_of(c.body.initial_length, c.body.pitch))
    y_rate = sample[march.V1] + c.body.mu * sample[march.LENGTH_RATE]
    row.stamp_ns, row.length_source = m.motion_ns, m.source
    row.initial_length = c.body.initial_length
    row.groove_phase = c.body.initial_length - front * c.body.pitch
    row.length, row.length_rate = c.body.initial_length + m.length_change, rate
    row.rear_position, row.front_position = zero + sample[march.X1], zero + sample[march.X2]
    row.rear_velocity = y_rate - c.body.mu * rate
    row.front_velocity = y_rate + (1.0 - c.body.mu) * rate
    row.rear_anchor = zero + m.rear_groove * c.body.pitch
    row.front_anchor = zero + m.front_groove * c.body.pitch
    row.rear_groove = m.rear_groove + m.moved
    row.front_groove = m.front_groove - m.pose_front + m.moved
    row.cable_force = sample[march.FORCE] - drag_of(c) * (rate - sample[march.LENGTH_RATE])
    row.rear_fin_force, row.front_fin_force = sample[march.REAR_FORCE], sample[march.FRONT_FORCE]
    row.power, row.energy = m.power, m.energy
    out.counts[0] += 1
    m.published_ns = m.motion_ns


@entry
def begin_track(
    memory: Memory, stamp: int, c: Constants, a: Actuator, p: Any, out: OutputRows
) -> None:
    """Put the twin at rest at a stamp, with the answer to the command as ΔL, and publish this state."""
    m = memory.record[0]
    put_at_rest(memory, stamp, m.answer, ESTIMATED, c)
    publish(memory, _update_power(memory, stamp, c, a, p), c, out)


@entry
def _follow_command(memory: Memory, next_command: int, a: Actuator) -> None:
    """Advance the answer to the row being processed. `answered` becomes 1 if the command at it is known, else 0."""
    m, row = memory.record[0], memory.rows[memory.record[0].place]
    m.answered = 1
    if row.kind == LENGTH_KIND:
        row.c = math.nan
    if row.kind == COMMAND_KIND:
        if not m.command_ns:
            m.command_ns = row.stamp
        pulls = row.a < -PULLED_M
        if m.pulling and not pulls:
            m.released_ns = row.stamp
        m.pulling = 1 if pulls else 0
        _answer(memory, row.stamp, row.a, a)
    elif m.command_ns and next_command >= 0:
        after = memory.rows[next_command]
        share = (row.stamp - m.command_ns) / (after.stamp - m.command_ns)
        _answer(memory, row.stamp, m.command + share * (after.a - m.command), a)
        if row.kind == LENGTH_KIND:
            row.c = m.answer
    else:
        m.answered = 0


@entry
def _follow(memory: Memory, c: Constants, a: Actuator, p: Any, out: OutputRows) -> None:
    """Advance answer and motion to the row being processed.

    `answered` and `arrived` become 1 if the answer and the motion have reached the row, else 0. `drives` becomes 1 if
    the row drives the motion.
    """
    m, row = memory.record[0], memory.rows[memory.record[0].place]
    stamp, until = row.stamp, row.stamp + LOOK_AHEAD_NS
    next_command = next_of(memory, COMMAND_KIND, until)
    next_length = next_of(memory, LENGTH_KIND, until)
    start, before = m.command, m.answer
    _follow_command(memory, next_command, a)
    fresh = next_length >= 0 and m.measured_ns > 0
    fresh = fresh and memory.rows[next_length].stamp - m.measured_ns <= LOOK_AHEAD_NS
    measured = row.kind == LENGTH_KIND
    m.arrived = 1
    # The first motion begins with a measured length if one follows: the driver may hold the cable at any length.
    commanded = row.kind == COMMAND_KIND and not fresh and (m.moving or next_length < 0)
    m.drives = 1 if measured or commanded else 0
    if measured:
        m.measured_ns = stamp
    if m.drives:
        m.source = MEASURED if measured else ESTIMATED
    if not m.moving:
        m.arrived = m.drives
        if m.drives:
            length_change = row.a - m.initial_length if measured else m.answer
            put_at_rest(memory, stamp, length_change, m.source, c)
            publish(memory, _update_power(memory, stamp, c, a, p), c, out)
    elif measured:
        _move_along(memory, stamp, stamp, row.a - m.initial_length, c)
    elif m.drives and not m.on_estimate:
        _move_along(memory, stamp, stamp, m.answer, c)
        m.on_estimate = 1
    elif m.drives:
        _move_with_answer(memory, stamp, start, m.command, before, c, a)
    else:
        first = next_length >= 0 and (fresh or not m.answered)
        first = first or (0 <= next_length < next_command)
        _follow_between(memory, start, before, next_length if first else -1, next_command, c, a)


@entry
def _follow_between(
    memory: Memory,
    start: float,
    before: float,
    next_length: int,
    next_command: int,
    c: Constants,
    a: Actuator,
) -> None:
    """Advance the motion to a row that does not drive it, towards the next row that does.

    If no such row is known, the motion stays, and `arrived` becomes 0. ``next_length`` is the index of the measured
    length towards which ΔL moves, or −1 if ΔL moves towards the answer at ``next_command``.
    """
    m, rows = memory.record[0], memory.rows
    stamp = rows[m.place].stamp
    if next_length >= 0:
        after = rows[next_length]
        _move_along(memory, stamp, after.stamp, after.a - m.initial_length, c)
    elif not m.answered:
        m.arrived = 0
    elif m.on_estimate:
        _move_with_answer(memory, stamp, start, m.command, before, c, a)
    else:
        after = rows[next_command]
        duration = (after.stamp - stamp) * SECONDS_PER_NS
        target = m.answer
        if m.engaged:
            target = respond(m.answer, m.command, after.a, duration, a)
        _move_along(memory, stamp, after.stamp, target, c)


@entry
def _leaves_zero(memory: Memory) -> bool:
    """Return True if the command leaves 0 at this row or the next command, and no driver state has arrived."""
    m = memory.record[0]
    row = memory.rows[m.place]
    if m.activity >= 0 or m.engaged or row.kind != COMMAND_KIND:
        return False
    k = next_of(memory, COMMAND_KIND, row.stamp + LOOK_AHEAD_NS)
    return row.a < -MOVED_M or (k >= 0 and memory.rows[k].a < -MOVED_M)


@entry
def _gap(memory: Memory) -> float:
    """Return the duration (s) of a gap before the next driving length when the gap is first detected; otherwise 0."""
    m, row = memory.record[0], memory.rows[memory.record[0].place]
    if not m.moving or row.stamp - m.motion_ns <= PAUSE_NS - LOOK_AHEAD_NS:
        return 0.0
    stamp = row.stamp
    if row.kind != LENGTH_KIND and row.kind != COMMAND_KIND:
        until = row.stamp + LOOK_AHEAD_NS
        command, length = next_of(memory, COMMAND_KIND, until), next_of(memory, LENGTH_KIND, until)
        k = min(command, length) if command >= 0 and length >= 0 else max(command, length)
        if k < 0:
            return 0.0
        stamp = memory.rows[k].stamp
    if stamp - m.motion_ns <= PAUSE_NS or m.paused_ns > m.motion_ns:
        return 0.0
    duration = (stamp - m.motion_ns) * SECONDS_PER_NS
    m.paused_ns = row.stamp
    m.blind_s += duration
    return duration


@entry
def _boundary(memory: Memory) -> int:
    """Return the boundary that Python has to handle before the next row; DONE if there is no boundary."""
    m, row = memory.record[0], memory.rows[memory.record[0].place]
    if m.cycle_end_ns and row.stamp >= m.cycle_end_ns:
        return CYCLE_END
    if row.kind == GAIT_KIND:
        m.processed_ns = row.stamp
        return DRIVER_STATE
    if _leaves_zero(memory):
        m.processed_ns = row.stamp
        return UNANNOUNCED_RUN
    return DONE


@entry
def _process_row(memory: Memory, c: Constants, a: Actuator, p: Any, out: OutputRows) -> None:
    """Advance answer, motion and power to the next row, and compare the row with them."""
    m, row = memory.record[0], memory.rows[memory.record[0].place]
    gap = _gap(memory)
    if gap:
        _report(out, GAP, row.stamp, gap)
    moving = m.moving
    _follow(memory, c, a, p, out)
    m.processed_ns = row.stamp
    if memory.totals[march.FAILURE] != 0.0:
        memory.totals[march.FAILURE] = 0.0
        put_at_rest(memory, row.stamp, m.length_change, m.source, c)
        _report(out, ZENO, row.stamp, 0.0)
        m.place += 1
        return
    if row.kind == COMMAND_KIND and row.stamp - m.estimated_ns >= PERIOD_NS:
        line = out.lengths[out.counts[2]]
        line.stamp_ns, line.length_change = row.stamp, m.answer
        line.length = c.body.initial_length + m.answer
        out.counts[2] += 1
        m.estimated_ns = row.stamp
    if m.arrived and (m.drives or row.kind > POSITION_KIND):
        rate = _update_power(memory, row.stamp, c, a, p)
        if m.drives and moving and row.stamp - m.published_ns >= PERIOD_NS:
            publish(memory, rate, c, out)
    shift = judge(memory, c, out)
    if shift != 0.0:
        _report(out, TRACKER_MOVED, row.stamp, shift)
    m.place += 1


@unlocked
def process(memory: Memory, lag: int, c: Constants, a: Actuator, p: Any, out: OutputRows) -> int:
    """Process all rows that are at least ``lag`` ns older than the newest, up to a boundary; return the boundary."""
    m = memory.record[0]
    while m.place < m.filled and memory.rows[m.place].stamp <= m.present - lag:
        boundary = _boundary(memory)
        if boundary != DONE:
            return boundary
        _process_row(memory, c, a, p, out)
    return DONE
