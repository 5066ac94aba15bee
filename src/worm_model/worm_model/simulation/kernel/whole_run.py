# SPDX-License-Identifier: Apache-2.0
"""Whole runs: a gait from the start, a sampled length, and batches over all cores."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from worm_model.simulation.kernel.actuation_law import (
    Actuator,
    answer_to_line,
    answer_to_sinusoid,
    value_at,
)
from worm_model.simulation.kernel.compiled import compiled, entry, inlined, unlocked
from worm_model.simulation.kernel.linear import Coefficients, Wave
from worm_model.simulation.kernel.march import (
    CHATTER,
    FORCE,
    LENGTH_RATE,
    SAMPLE_COLUMNS,
    SAMPLED,
    SWITCHES,
    TIME,
    TOTALS_SIZE,
    WORK_DONE,
    Segment,
    march,
)
from worm_model.simulation.kernel.mode import Constants, Motion, nearest_groove_of, region_of

# Columns of a result row
MEAN_ADVANCE, MEAN_POWER, LEAST_ADVANCE, RUN_SWITCHES, RUN_CHATTER = range(5)
RESULT_COLUMNS = 5
# Columns of a row of how far a run is at the start of a cycle
REACHED, CABLE_WORK, SWITCHED = range(3)
BOUNDARY_COLUMNS = 3

STEADY = 1e-14  # m, m/s, to which two states are one: as exactly as events are located


@entry
def constants_of(p: Any, direction: float, margin: float) -> Constants:
    """Constants of a parameter row; forward, the fin is stiff when pushed backward (below its clearance)."""
    mass = p.rear_mass + p.front_mass
    below, above = p.engaged_stiffness, p.disengaged_stiffness
    if direction < 0:
        below, above = above, below
    return Constants(
        mass=mass,
        mu=p.front_mass / mass,
        friction=p.viscous_friction,
        stiffness_below=below,
        stiffness_above=above,
        half_clearance=0.5 * p.clearance,
        threshold=p.switching_threshold + margin,
        pitch=p.pitch,
        initial_length=p.initial_length,
        rear_mass=p.rear_mass,
        bellows_stiffness=p.bellows_stiffness,
        bellows_damping=p.bellows_damping,
        unstressed_length=p.unstressed_length,
        rear_dry=p.rear_dry_friction,
        front_dry=p.front_dry_friction,
        one_sided_cable=p.one_sided_cable != 0.0,
    )


@compiled
def start_motion(c: Constants, a: Actuator) -> Motion:
    """x1 = 0, v1 = 0, A1 = 0, ΔL = 0, the front anchor on the nearest groove; ẏ = v1 + μ·L̇."""
    length_rate = -a.gain * a.slack / a.time_constant
    front_groove = int(nearest_groove_of(c.initial_length, c.pitch))
    phase = c.initial_length - front_groove * c.pitch
    return Motion(0.0, c.mu * length_rate, 0, front_groove, 1, region_of(phase, c.half_clearance))


@inlined
def actuator_of(p: Any) -> Actuator:
    """K, δ_s and τ of a parameter row."""
    return Actuator(p.gain, p.slack, p.time_constant)


@compiled
def play(
    first: float,
    last: float,
    g: Any,
    length_change: float,
    motion: Motion,
    c: Constants,
    a: Actuator,
    totals: np.ndarray,
    samples: np.ndarray,
    events: np.ndarray,
) -> tuple[float, Motion]:
    """Plays a gait from ``first`` to ``last`` in s since its onset; returns (ΔL in m, the motion) at the end.

    ``g`` is a gait's row, ``length_change`` is ΔL at the start; the arrays are those of `march`. Within a cycle the
    command leaves the slack at the phase arccos(1 − 2·δ_s/S) and comes back to it as long before the end.
    """
    stroke, frequency = g.stroke, g.frequency
    period = 1.0 / frequency
    opening = 0.5 * period
    if stroke > a.slack:
        opening = math.acos(1.0 - 2.0 * a.slack / stroke) / (2.0 * math.pi * frequency)
    start, cycle = first, math.floor(first * frequency + 1e-9)
    while start < last and totals[CHATTER] == 0.0:
        begin = cycle * period
        borders = (begin + opening, begin + period - opening, begin + period)
        for part in range(3):
            end = min(borders[part], last)
            if end <= start or totals[CHATTER] != 0.0:
                continue
            omega = 2.0 * math.pi * frequency if part == 1 else 0.0
            if part == 1:
                phase = omega * (start - begin)
                form = answer_to_sinusoid(length_change, stroke, omega, phase, a)
            else:
                form = answer_to_line(length_change, -a.gain * a.slack, 0.0, a)
            segment = Segment(start, end - start, form, Wave(c.mass, omega, -1.0 / a.time_constant))
            motion = march(segment, motion, c, totals, samples, events)
            length_change = value_at(form, end - start, omega, a.time_constant)
            start = end
        cycle += 1
    return length_change, motion


@entry
def run_gait(
    g: Any,
    p: Any,
    cycles: int,
    totals: np.ndarray,
    samples: np.ndarray,
    events: np.ndarray,
) -> None:
    """Runs a gait from the start for a number of cycles; the arrays are those of `march`."""
    c, a = constants_of(p, g.direction, g.margin), actuator_of(p)
    motion, last = start_motion(c, a), cycles * (1.0 / g.frequency)
    play(0.0, last, g, 0.0, motion, c, a, totals, samples, events)


@inlined
def _alike(before: Motion, after: Motion, c: Constants) -> bool:
    """Whether two motions are one within STEADY, but for the grooves that both anchors have gained."""
    gained = after.rear_groove - before.rear_groove
    moved = after.y - before.y - gained * c.pitch
    return (
        after.front_groove - before.front_groove == gained
        and after.rear_region == before.rear_region
        and after.front_region == before.front_region
        and abs(moved) <= STEADY
        and abs(after.rate - before.rate) <= STEADY
    )


@compiled
def run_cycles(
    g: Any,
    c: Constants,
    a: Actuator,
    boundaries: np.ndarray,
    totals: np.ndarray,
) -> None:
    """Runs a gait from the start for a number of cycles, unless the march gives up; ``totals`` are those of `march`.

    ``boundaries`` (cycles + 1, BOUNDARY_COLUMNS) receives x1 in m, the cable work so far in J and the switches so far
    at the start of each cycle and at the end. All that a cycle does follows from the state in which it begins: once
    that is the state in which the cycle before began, every further cycle is that one again, and not run.
    """
    nothing = np.empty((0, SAMPLE_COLUMNS))
    motion, length_change, steady = start_motion(c, a), 0.0, False
    before, period = motion, 1.0 / g.frequency
    boundaries[0] = 0.0
    for cycle in range(boundaries.shape[0] - 1):
        now, then = boundaries[cycle], boundaries[cycle + 1]
        if steady:
            gained = motion.rear_groove - before.rear_groove
            then[REACHED] = now[REACHED] + gained * c.pitch
            for k in (CABLE_WORK, SWITCHED):
                then[k] = now[k] + (now[k] - boundaries[cycle - 1, k])
            continue
        before, length_before, first = motion, length_change, cycle * period
        last = first + period
        length_change, motion = play(
            first, last, g, length_change, motion, c, a, totals, nothing, nothing
        )
        if totals[CHATTER] != 0.0:
            return
        steady = abs(length_change - length_before) <= STEADY and _alike(before, motion, c)
        then[REACHED] = motion.y - c.mu * length_change
        then[CABLE_WORK] = totals[WORK_DONE]
        then[SWITCHED] = totals[SWITCHES]
    totals[SWITCHES] = then[SWITCHED]


@entry
def evaluate(
    g: Any,
    p: Any,
    cycles: int,
    averaged: int,
    result: np.ndarray,
) -> None:
    """Fills a result row for a gait.

    Its entries: mean advance of x1 a cycle in m along the direction, mean power in W, least advance of an
    averaged cycle in m, switches in the whole run, and whether the run gave up.
    """
    frequency, direction = g.frequency, g.direction
    boundaries = np.empty((cycles + 1, BOUNDARY_COLUMNS))
    totals = np.zeros(TOTALS_SIZE)
    c, a = constants_of(p, direction, g.margin), actuator_of(p)
    run_cycles(g, c, a, boundaries, totals)
    result[RUN_SWITCHES] = totals[SWITCHES]
    result[RUN_CHATTER] = totals[CHATTER]
    if totals[CHATTER] != 0.0:
        result[MEAN_ADVANCE] = result[MEAN_POWER] = result[LEAST_ADVANCE] = math.nan
        return
    first = cycles - averaged
    least = math.inf
    for cycle in range(first, cycles):
        gained = boundaries[cycle + 1, REACHED] - boundaries[cycle, REACHED]
        least = min(least, direction * gained)
    result[LEAST_ADVANCE] = least
    way = boundaries[cycles, REACHED] - boundaries[first, REACHED]
    result[MEAN_ADVANCE] = direction * way / averaged
    work = boundaries[cycles, CABLE_WORK] - boundaries[first, CABLE_WORK]
    result[MEAN_POWER] = p.idle_power + p.power_factor * work * frequency / averaged


@unlocked
def evaluate_many(
    gaits: np.ndarray, parameters: np.ndarray, cycles: int, averaged: int, results: np.ndarray
) -> None:
    """`evaluate` of rows, without the interpreter's lock.

    ``gaits`` (n,) of GAIT_ROW; ``parameters`` (n,) of PARAMETER_ROW, or one row, shared (`simulation.rows`);
    ``results`` (n, RESULT_COLUMNS).
    """
    shared = parameters.shape[0] == 1
    for k in range(gaits.shape[0]):
        evaluate(gaits[k], parameters[0 if shared else k], cycles, averaged, results[k])


@unlocked
def sample_many(
    gaits: np.ndarray,
    p: Any,
    cycle: int,
    phases: np.ndarray,
    force: np.ndarray,
    length_rate: np.ndarray,
) -> None:
    """Samples a cycle, counted from 0, of gaits (n,) of GAIT_ROW, without the interpreter's lock.

    ``phases`` (m,), ascending, are shares of the cycle; ``force`` and ``length_rate`` (n, m) receive F_c in N and L̇ in
    m/s there, NaN where the run gave up.
    """
    samples = np.empty((phases.size, SAMPLE_COLUMNS))
    for k in range(gaits.shape[0]):
        totals = np.zeros(TOTALS_SIZE)
        samples[:, TIME] = (cycle + phases) / gaits[k].frequency
        run_gait(gaits[k], p, cycle + 1, totals, samples, samples[:0])
        if totals[CHATTER] != 0.0:
            samples[:] = math.nan
        force[k], length_rate[k] = samples[:, FORCE], samples[:, LENGTH_RATE]


@unlocked
def run_sampled(
    breaks: np.ndarray,
    coefficients: np.ndarray,
    motion: Motion,
    c: Constants,
    totals: np.ndarray,
    samples: np.ndarray,
    events: np.ndarray,
) -> Motion:
    """Runs under a piecewise cubic ΔL from breaks[0] to breaks[-1]; returns the motion at the end.

    ``breaks`` (n + 1,) in s, ascending; ``coefficients`` (4, n), constant term first, of the time since
    the segment's break; the other arrays are those of `march`.
    """
    still = Wave(c.mass, 0.0, 0.0)
    for k in range(breaks.size - 1):
        duration = breaks[k + 1] - breaks[k]
        if duration < 0.0:
            continue
        form = Coefficients(
            coefficients[0, k],
            coefficients[1, k],
            coefficients[2, k],
            coefficients[3, k],
            0.0,
            0.0,
            0.0,
            0.0,
            0.0,
            0.0,
        )
        segment = Segment(breaks[k], duration, form, still)
        motion = march(segment, motion, c, totals, samples, events)
        if totals[CHATTER] != 0.0:
            break
    return motion


@compiled
def step(
    segment: Segment, motion: Motion, c: Constants, totals: np.ndarray, sample: np.ndarray
) -> Motion:
    """The motion at a segment's end, which ``sample`` (1, SAMPLE_COLUMNS) describes; see `march`."""
    totals[SAMPLED] = 0.0
    sample[0, TIME] = segment.start + segment.duration
    return march(segment, motion, c, totals, sample, sample[:0])


@entry
def play_on(
    g: Any,
    p: Any,
    c: Constants,
    length_change: float,
    motion: Motion,
    totals: np.ndarray,
    samples: np.ndarray,
) -> Motion:
    """Plays a gait that begins at time 0 with a motion and ΔL (m), up to the last row's time of ``samples``."""
    last = samples[samples.shape[0] - 1, TIME]
    a = actuator_of(p)
    _, motion = play(0.0, last, g, length_change, motion, c, a, totals, samples, samples[:0])
    return motion
