# SPDX-License-Identifier: Apache-2.0
"""Whole runs: a gait from the start, a sampled length, and batches over all cores."""

from __future__ import annotations

import math

import numpy as np

from worm_model.simulation.kernel.compiled import compiled, entry, inlined, unlocked
from worm_model.simulation.kernel.linear import Coefficients, Wave
from worm_model.simulation.kernel.march import (
    CHATTER,
    LEDGER_SIZE,
    SAMPLE_COLUMNS,
    SWITCHES,
    WORK_DONE,
    Segment,
    march,
)
from worm_model.simulation.kernel.mode import Constants, Motion, region_of

# Columns of a parameter row, the keys of a parameter file in the order of `worm_model.parameters.KEYS`
(
    REAR_MASS,
    FRONT_MASS,
    UNSTRESSED_LENGTH,
    INITIAL_LENGTH,
    BELLOWS_STIFFNESS,
    BELLOWS_DAMPING,
    VISCOUS_FRICTION,
    PITCH,
    ENGAGED_STIFFNESS,
    DISENGAGED_STIFFNESS,
    SWITCHING_THRESHOLD,
    CLEARANCE,
    TIME_CONSTANT,
    GAIN,
    SLACK,
    IDLE_POWER,
    POWER_FACTOR,
) = range(17)
# Columns of a result row
MEAN_ADVANCE, MEAN_POWER, LEAST_ADVANCE, RUN_SWITCHES, RUN_CHATTER = range(5)
RESULT_COLUMNS = 5


@entry
def constants_of(p: np.ndarray, direction: float, margin: float) -> Constants:
    """Constants of a parameter row; forward, the fin is stiff when pushed backward (below its clearance)."""
    mass = p[REAR_MASS] + p[FRONT_MASS]
    forward = direction > 0
    return Constants(
        mass,
        p[FRONT_MASS] / mass,
        p[VISCOUS_FRICTION],
        p[ENGAGED_STIFFNESS] if forward else p[DISENGAGED_STIFFNESS],
        p[DISENGAGED_STIFFNESS] if forward else p[ENGAGED_STIFFNESS],
        0.5 * p[CLEARANCE],
        p[SWITCHING_THRESHOLD] + margin,
        p[PITCH],
        p[INITIAL_LENGTH],
        p[REAR_MASS],
        p[BELLOWS_STIFFNESS],
        p[BELLOWS_DAMPING],
        p[UNSTRESSED_LENGTH],
    )


@compiled
def start_motion(c: Constants, length_rate: float) -> Motion:
    """x1 = 0, v1 = 0, A1 = 0, ΔL = 0, the front anchor on the nearest groove; ẏ = v1 + μ·L̇."""
    front_groove = math.ceil(c.initial_length / c.pitch - 0.5 - 1e-12)
    phase = c.initial_length - front_groove * c.pitch
    return Motion(0.0, c.mu * length_rate, 0, front_groove, 1, region_of(phase, c.half_clearance))


@inlined
def _clipped_segment(
    start: float, end: float, length_change: float, p: np.ndarray, mass: float
) -> Segment:
    """ΔL relaxes to −K·δ_s while the command is within the slack."""
    rest = -p[GAIN] * p[SLACK]
    form = Coefficients(rest, 0.0, 0.0, 0.0, 0.0, 0.0, length_change - rest, 0.0, 0.0, 0.0)
    return Segment(start, end - start, form, Wave(mass, 0.0, -1.0 / p[TIME_CONSTANT]))


@inlined
def _open_segment(
    start: float,
    end: float,
    phase: float,
    length_change: float,
    stroke: float,
    p: np.ndarray,
    omega: float,
    mass: float,
) -> Segment:
    """ΔL follows the sinusoid, whose phase at the start of the segment is given."""
    lag = omega * p[TIME_CONSTANT]
    amplitude = 0.5 * p[GAIN] * stroke / (1.0 + lag * lag)
    # amplitude·(cos(ωt) + lag·sin(ωt)), ωt = phase + ωσ
    cos = amplitude * (math.cos(phase) + lag * math.sin(phase))
    sin = amplitude * (lag * math.cos(phase) - math.sin(phase))
    mean = -0.5 * p[GAIN] * stroke
    form = Coefficients(mean, 0.0, 0.0, 0.0, cos, sin, length_change - mean - cos, 0.0, 0.0, 0.0)
    return Segment(start, end - start, form, Wave(mass, omega, -1.0 / p[TIME_CONSTANT]))


@inlined
def _end_value(segment: Segment) -> float:
    form, wave = segment.length_change, segment.wave
    angle = wave.omega * segment.duration
    return (
        form.one
        + form.cos * math.cos(angle)
        + form.sin * math.sin(angle)
        + form.exp * math.exp(wave.q * segment.duration)
    )


@entry
def run_gait(
    stroke: float,
    frequency: float,
    direction: float,
    margin: float,
    p: np.ndarray,
    cycles: int,
    boundaries: np.ndarray,
    ledger: np.ndarray,
    samples: np.ndarray,
    events: np.ndarray,
) -> None:
    """Runs a gait from the start for a number of cycles.

    ``boundaries`` (cycles + 1, 2) receives x1 in m and the cable work so far in J at the start of each
    cycle and at the end; the other arrays are those of `march`.
    """
    c = constants_of(p, direction, margin)
    period = 1.0 / frequency
    omega = 2.0 * math.pi * frequency
    opening = math.acos(max(-1.0, 1.0 - 2.0 * p[SLACK] / stroke)) / omega
    clipped_throughout = stroke <= p[SLACK]
    if clipped_throughout:
        opening = 0.5 * period
    motion = start_motion(c, -p[GAIN] * p[SLACK] / p[TIME_CONSTANT])
    length_change = 0.0
    boundaries[0, 0] = boundaries[0, 1] = 0.0
    for cycle in range(cycles):
        start = cycle * period
        segment = _clipped_segment(start, start + opening, length_change, p, c.mass)
        motion = march(segment, motion, c, ledger, samples, events)
        length_change = _end_value(segment)
        if not clipped_throughout:
            opened = _open_segment(
                start + opening,
                start + period - opening,
                omega * opening,
                length_change,
                stroke,
                p,
                omega,
                c.mass,
            )
            motion = march(opened, motion, c, ledger, samples, events)
            length_change = _end_value(opened)
        segment = _clipped_segment(
            start + period - opening, start + period, length_change, p, c.mass
        )
        motion = march(segment, motion, c, ledger, samples, events)
        length_change = _end_value(segment)
        if ledger[CHATTER] != 0.0:
            return
        boundaries[cycle + 1, 0] = motion.y - c.mu * length_change
        boundaries[cycle + 1, 1] = ledger[WORK_DONE]


@entry
def evaluate(
    stroke: float,
    frequency: float,
    direction: float,
    margin: float,
    p: np.ndarray,
    cycles: int,
    averaged: int,
    result: np.ndarray,
) -> None:
    """Fills a result row for a gait.

    Its entries: mean advance of x1 a cycle in m along the direction, mean power in W, least advance of an
    averaged cycle in m, switches in the whole run, and whether the run gave up.
    """
    boundaries = np.empty((cycles + 1, 2))
    ledger = np.zeros(LEDGER_SIZE)
    nothing = np.empty((0, SAMPLE_COLUMNS))
    run_gait(stroke, frequency, direction, margin, p, cycles, boundaries, ledger, nothing, nothing)
    result[RUN_SWITCHES] = ledger[SWITCHES]
    result[RUN_CHATTER] = ledger[CHATTER]
    if ledger[CHATTER] != 0.0:
        result[MEAN_ADVANCE] = result[MEAN_POWER] = result[LEAST_ADVANCE] = math.nan
        return
    first = cycles - averaged
    least = math.inf
    for cycle in range(first, cycles):
        least = min(least, direction * (boundaries[cycle + 1, 0] - boundaries[cycle, 0]))
    result[LEAST_ADVANCE] = least
    result[MEAN_ADVANCE] = direction * (boundaries[cycles, 0] - boundaries[first, 0]) / averaged
    work = boundaries[cycles, 1] - boundaries[first, 1]
    result[MEAN_POWER] = p[IDLE_POWER] + p[POWER_FACTOR] * work * frequency / averaged


@unlocked
def evaluate_many(
    gaits: np.ndarray, parameters: np.ndarray, cycles: int, averaged: int, results: np.ndarray
) -> None:
    """`evaluate` of rows (stroke, frequency, direction, margin), without the interpreter's lock.

    ``gaits`` (n, 4); ``parameters`` (n, 17) or (1, 17), shared; ``results`` (n, RESULT_COLUMNS).
    """
    shared = parameters.shape[0] == 1
    for k in range(gaits.shape[0]):
        evaluate(
            gaits[k, 0],
            gaits[k, 1],
            gaits[k, 2],
            gaits[k, 3],
            parameters[0 if shared else k],
            cycles,
            averaged,
            results[k],
        )


@unlocked
def run_sampled(
    breaks: np.ndarray,
    coefficients: np.ndarray,
    motion: Motion,
    c: Constants,
    ledger: np.ndarray,
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
        motion = march(segment, motion, c, ledger, samples, events)
        if ledger[CHATTER] != 0.0:
            break
    return motion
