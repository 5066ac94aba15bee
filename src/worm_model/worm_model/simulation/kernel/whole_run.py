# SPDX-License-Identifier: Apache-2.0
"""Whole runs: gaits from the start, motions under a sampled length, and batches of gaits.

In this module ``g`` is a gait as a row of GAIT_ROW, and ``p`` are parameters as a row of PARAMETER_ROW
(`worm_model.simulation.rows`).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from worm_model.simulation.kernel import march, mode
from worm_model.simulation.kernel.actuation_law import Actuator, rest_of, value_at
from worm_model.simulation.kernel.compiled import compiled, entry, inlined, unlocked
from worm_model.simulation.kernel.grooves import Grooves
from worm_model.simulation.kernel.guard import NEVER
from worm_model.simulation.kernel.linear import Coefficients, Wave
from worm_model.simulation.kernel.waveform import PARTS, answer_to_part, borders_of

# Columns of a result row
MEAN_ADVANCE, MEAN_POWER, LEAST_ADVANCE, RUN_SWITCHES, RUN_FAILURE = range(5)
RESULT_COLUMNS = 5
SLIDES = 2.0  # value of the entry FAILURE of the totals: the fins do not hold the load at rest
# Columns of a row with the progress of a run at the start of a cycle: x1 in m, cable work in J, number of switches
REACHED, CABLE_WORK, SWITCHED = range(3)
BOUNDARY_COLUMNS = 3

#: s; `rest_at` changes the length over this time, and then waits as long again for the motion to decay.
SETTLING_TIME = 1.0
# m, m/s; two states count as equal if they differ by at most this value, the accuracy with which events are located.
STEADY = 1e-14
REGIONS = 3  # of a fin's deflection


@entry
def constants_of(p: Any, direction: float, margin: float) -> mode.Constants:
    """Return the constants of a parameter row for a direction (±1) and a margin in m.

    In the forward direction, a fin is stiff for deflections below −δ_c/2, which occur when its module is pushed
    backward.
    """
    mass = p.rear_mass + p.front_mass
    below, above = p.engaged_stiffness, p.disengaged_stiffness
    if direction < 0:
        below, above = above, below
    fin = mode.Fin(below, above, p.switching_threshold + margin)
    body = mode.Body(
        mass=mass,
        mu=p.front_mass / mass,
        friction=p.viscous_friction,
        half_clearance=0.5 * p.clearance,
        pitch=p.pitch,
        initial_length=p.initial_length,
        rear_mass=p.rear_mass,
        bellows_stiffness=p.bellows_stiffness,
        bellows_damping=p.bellows_damping,
        unstressed_length=p.unstressed_length,
        one_sided_cable=p.one_sided_cable != 0.0,
    )
    resistance = mode.Resistance(
        rear_dry=p.rear_dry_friction,
        front_dry=p.front_dry_friction,
        rear_load=p.rear_load,
        load=p.rear_load + p.front_load,
    )
    return mode.Constants(body, fin, fin, resistance)


@inlined
def actuator_of(p: Any) -> Actuator:
    """Return K, δ_s and τ of a parameter row."""
    return Actuator(p.gain, p.slack, p.time_constant)


@compiled
def play(
    first: float,
    last: float,
    g: Any,
    length_change: float,
    motion: mode.Motion,
    c: mode.Constants,
    a: Actuator,
    records: march.Records,
) -> tuple[float, mode.Motion]:
    """Play a gait from ``first`` to ``last`` in s since its onset, and return (ΔL in m, the motion) at the end.

    ``length_change`` and ``motion`` are ΔL in m and the motion at ``first``.
    """
    totals = records.totals
    period = 1.0 / g.frequency
    start, cycle = first, math.floor(first * g.frequency + 1e-9)
    while start < last and totals[march.FAILURE] == 0.0:
        begin = cycle * period
        borders = borders_of(begin, g, a)
        for part in range(PARTS):
            end = min(borders[part], last)
            if end <= start or totals[march.FAILURE] != 0.0:
                continue
            form, omega = answer_to_part(part, begin, start, length_change, g, a)
            segment = march.Segment(
                start, end - start, form, Wave(c.body.mass, omega, -1.0 / a.time_constant)
            )
            motion = march.march(segment, motion, c, None, records)
            length_change = value_at(form, end - start, omega, a.time_constant)
            start = end
        cycle += 1
    return length_change, motion


@compiled
def _balance(offset: float, c: mode.Constants) -> tuple[float, int, int]:
    """Return (deflection of the rear fin in m, region of the rear fin, region of the front fin) in the equilibrium.

    ``offset`` in m is the deflection of the front fin minus that of the rear one. For each pair of regions, the
    equilibrium of the fins with the load is computed as if the fins were in these regions. The sum of both
    fin forces increases with the deflection. So exactly one pair contains the equilibrium that is computed for it,
    except for rounding at a border. The function returns the pair whose equilibrium lies least outside of its regions.
    """
    best, deflection, regions = NEVER, 0.0, 0
    for pair in range(REGIONS * REGIONS):
        rear, front = pair // REGIONS, pair % REGIONS
        rear_k, front_k = (
            mode.fin_stiffness(rear, c.rear_fin),
            mode.fin_stiffness(front, c.front_fin),
        )
        if rear_k + front_k == 0.0:
            continue
        rear_rest = (rear - 1.0) * c.body.half_clearance
        front_rest = (front - 1.0) * c.body.half_clearance - offset
        x = (rear_k * rear_rest + front_k * front_rest - c.resistance.load) / (rear_k + front_k)
        outside = max(_outside(x, rear, c), _outside(x + offset, front, c))
        if outside < best:
            best, deflection, regions = outside, x, pair
    return deflection, regions // REGIONS, regions % REGIONS


@compiled
def _outside(deflection: float, region: int, c: mode.Constants) -> float:
    """Return the distance by which a deflection lies outside of a region, m."""
    if region == mode.ABOVE:
        return max(c.body.half_clearance - deflection, 0.0)
    if region == mode.BELOW:
        return max(deflection + c.body.half_clearance, 0.0)
    return max(abs(deflection) - c.body.half_clearance, 0.0)


@compiled
def start_of(g: Any, c: mode.Constants, a: Actuator) -> tuple[bool, float, mode.Motion]:
    """Return (True if the fins hold the load, ΔL in m, the motion) at the start of a gait.

    ``g`` is a row of GAIT_ROW. Without a load, x1 = 0. With a load, the fins are in equilibrium with it. The front
    anchor is the groove nearest to the front module at ΔL = 0. A fin beyond its threshold slips into the next groove at
    once, the rear fin first. The fins do not hold the load if the slipping does not end. v1 = 0, so that y′ = μ·L′.
    """
    length_change = rest_of(g.pretension, a)
    length_rate = 0.0 if g.pretension > 0.0 else -a.gain * a.slack / a.time_constant
    rear_groove, front_groove = 0, int(mode.nearest_groove_of(c.body.initial_length, c.body.pitch))
    slips = int(abs(length_change) / c.body.pitch) + 4
    for _ in range(slips):
        gap = (front_groove - rear_groove) * c.body.pitch
        offset = c.body.initial_length + length_change - gap
        if c.resistance.load != 0.0:
            rear, rear_region, front_region = _balance(offset, c)
        else:
            rear = -rear_groove * c.body.pitch
            rear_region = mode.region_of(rear, c.body.half_clearance)
            front_region = mode.region_of(rear + offset, c.body.half_clearance)
        if abs(rear) > c.rear_fin.threshold:
            rear_groove += 1 if rear > 0.0 else -1
        elif abs(rear + offset) > c.front_fin.threshold:
            front_groove += 1 if rear + offset > 0.0 else -1
        else:
            y = rear + rear_groove * c.body.pitch + c.body.mu * length_change
            motion = mode.Motion(
                y, c.body.mu * length_rate, rear_groove, front_groove, rear_region, front_region
            )
            return True, length_change, motion
    return False, length_change, mode.Motion(0.0, 0.0, rear_groove, front_groove, 1, 1)


@entry
def run_gait(g: Any, p: Any, cycles: int, records: march.Records) -> None:
    """Run a gait from the start for a number of cycles."""
    c, a = constants_of(p, g.direction, g.margin), actuator_of(p)
    held, length_change, motion = start_of(g, c, a)
    if not held:
        records.totals[march.FAILURE] = SLIDES
    play(0.0, cycles * (1.0 / g.frequency), g, length_change, motion, c, a, records)


@inlined
def _alike(before: mode.Motion, after: mode.Motion, c: mode.Constants) -> bool:
    """Return True if two motions are equal within STEADY, except for the grooves that both anchors have gained."""
    gained = after.rear_groove - before.rear_groove
    moved = after.y - before.y - gained * c.body.pitch
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
    c: mode.Constants,
    a: Actuator,
    boundaries: np.ndarray,
    totals: np.ndarray,
) -> None:
    """Run a gait from the start for a number of cycles, or until it fails; for ``totals`` see `march.Records`.

    ``boundaries`` (cycles + 1, BOUNDARY_COLUMNS) receives x1 in m, the cable work so far in J and the number of
    switches so far, at the start of each cycle and at the end of the run. A cycle is determined by the state at its
    start. Once two successive cycles start in the same state, all further cycles are repetitions and are not simulated.
    """
    nothing = np.empty((0, march.SAMPLE_COLUMNS))
    records = march.Records(totals, nothing, nothing)
    held, length_change, motion = start_of(g, c, a)
    if not held:
        totals[march.FAILURE] = SLIDES
        return
    steady, before, period = False, motion, 1.0 / g.frequency
    boundaries[0] = 0.0
    boundaries[0, REACHED] = motion.y - c.body.mu * length_change
    for cycle in range(boundaries.shape[0] - 1):
        now, then = boundaries[cycle], boundaries[cycle + 1]
        if steady:
            gained = motion.rear_groove - before.rear_groove
            then[REACHED] = now[REACHED] + gained * c.body.pitch
            for k in (CABLE_WORK, SWITCHED):
                then[k] = now[k] + (now[k] - boundaries[cycle - 1, k])
            continue
        before, length_before, first = motion, length_change, cycle * period
        last = first + period
        length_change, motion = play(first, last, g, length_change, motion, c, a, records)
        if totals[march.FAILURE] != 0.0:
            return
        steady = abs(length_change - length_before) <= STEADY and _alike(before, motion, c)
        then[REACHED] = motion.y - c.body.mu * length_change
        then[CABLE_WORK] = totals[march.WORK_DONE]
        then[SWITCHED] = totals[march.SWITCHES]
    totals[march.SWITCHES] = then[SWITCHED]


@entry
def evaluate(
    g: Any,
    p: Any,
    cycles: int,
    averaged: int,
    result: np.ndarray,
) -> None:
    """Run a gait from the start for a number of ``cycles``, and fill a result row.

    The entries are the mean advance of x1 per cycle in m along the direction and the mean power in W, both over the
    last ``averaged`` cycles; the smallest advance of one of these cycles in m; the number of switches in the whole run;
    and the failure of the run, or 0.
    """
    frequency, direction = g.frequency, g.direction
    boundaries = np.empty((cycles + 1, BOUNDARY_COLUMNS))
    totals = np.zeros(march.TOTALS_SIZE)
    c, a = constants_of(p, direction, g.margin), actuator_of(p)
    run_cycles(g, c, a, boundaries, totals)
    result[RUN_SWITCHES] = totals[march.SWITCHES]
    result[RUN_FAILURE] = totals[march.FAILURE]
    if totals[march.FAILURE] != 0.0:
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
    # Where the motion exceeds double precision, rounding makes the sum of the positive work negative.
    work = max(boundaries[cycles, CABLE_WORK] - boundaries[first, CABLE_WORK], 0.0)
    result[MEAN_POWER] = p.idle_power + p.power_factor * work * frequency / averaged


@unlocked
def evaluate_many(
    gaits: np.ndarray, parameters: np.ndarray, cycles: int, averaged: int, results: np.ndarray
) -> None:
    """Apply `evaluate` to many gaits, without Python's global interpreter lock.

    ``gaits`` (n,) of GAIT_ROW; ``parameters`` (n,) of PARAMETER_ROW, or (1,) for all gaits; ``results``
    (n, RESULT_COLUMNS) to be filled.
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
    """Sample one cycle (counted from 0) of gaits (n,) of GAIT_ROW, without Python's global interpreter lock.

    ``phases`` (n, m) are times as fractions of the cycle, ascending. ``force`` and ``length_rate`` (n, m) receive F_c
    in N and L̇ in m/s at these times, NaN if the run of a gait failed.
    """
    samples = np.empty((phases.shape[1], march.SAMPLE_COLUMNS))
    for k in range(gaits.shape[0]):
        totals = np.zeros(march.TOTALS_SIZE)
        samples[:, march.TIME] = (cycle + phases[k]) / gaits[k].frequency
        run_gait(gaits[k], p, cycle + 1, march.Records(totals, samples, samples[:0]))
        if totals[march.FAILURE] != 0.0:
            samples[:] = math.nan
        force[k], length_rate[k] = samples[:, march.FORCE], samples[:, march.LENGTH_RATE]


@unlocked
def run_sampled(
    breaks: np.ndarray,
    coefficients: np.ndarray,
    motion: mode.Motion,
    c: mode.Constants,
    grooves: Grooves | None,
    records: march.Records,
) -> mode.Motion:
    """Run under a piecewise cubic ΔL from breaks[0] to breaks[-1], and return the motion at the end.

    ``breaks`` (n + 1,) in s, ascending, are the borders of the segments. Column k of ``coefficients`` (4, n or more)
    contains the coefficients of ΔL in m in the time in s since breaks[k], constant term first. For the other arguments
    see `march`.
    """
    still = Wave(c.body.mass, 0.0, 0.0)
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
        segment = march.Segment(breaks[k], duration, form, still)
        motion = march.march(segment, motion, c, grooves, records)
        if records.totals[march.FAILURE] != 0.0:
            break
    return motion


@compiled
def rest_at(length_change: float, c: mode.Constants) -> mode.Motion:
    """Return the motion of a robot at rest at a ΔL in m, to which its length has moved from the start at ΔL = 0.

    At the start x1 = 0. Loads and dry friction are neglected, so the fins are in equilibrium with each other after the
    move.
    """
    groove = int(mode.nearest_groove_of(c.body.initial_length, c.body.pitch))
    front = mode.region_of(c.body.initial_length - groove * c.body.pitch, c.body.half_clearance)
    straight = mode.Motion(0.0, 0.0, 0, groove, mode.CLEAR, front)
    unloaded = mode.Resistance(0.0, 0.0, 0.0, 0.0)
    fins_alone = mode.Constants(c.body, c.rear_fin, c.front_fin, unloaded)
    coefficients = np.zeros((4, 2))
    coefficients[1, 0], coefficients[0, 1] = length_change / SETTLING_TIME, length_change
    breaks = SETTLING_TIME * np.arange(3.0)
    nothing = np.empty((0, march.SAMPLE_COLUMNS))
    records = march.Records(np.zeros(march.TOTALS_SIZE), nothing, nothing)
    return run_sampled(breaks, coefficients, straight, fins_alone, None, records)


@unlocked
def run_from_rest(
    breaks: np.ndarray,
    coefficients: np.ndarray,
    p: Any,
    direction: float,
    deflection: float,
    onset: float,
    rear_grooves: np.ndarray,
    front_grooves: np.ndarray,
    samples: np.ndarray,
) -> bool:
    """Run a robot from rest under a piecewise cubic ΔL, and return False if a fin chatters.

    Args:
        breaks: as in `run_sampled`.
        coefficients: as in `run_sampled`.
        p: parameter row.
        direction: direction of the fins, ±1.
        deflection: distance in m by which both modules are at first displaced from the position that `rest_at` returns.
            Dry friction or a load may hold them there.
        onset: ΔL begins with a step of its rate. This value determines how the modules share the rate. 0: their
            centre of mass stays at rest. 1: the rear module stays at rest, as in the paper's initial values.
        rear_grooves: grooves of the rear module, see `Grooves`.
        front_grooves: grooves of the front module, see `Grooves`.
        samples: see `march.Records`.
    """
    c = constants_of(p, direction, 0.0)
    change = coefficients[0, 0]
    rest = rest_at(change, c)
    rear = rest.y - c.body.mu * change + deflection
    front = rear + c.body.initial_length + change
    motion = mode.Motion(
        rest.y + deflection,
        onset * c.body.mu * coefficients[1, 0],
        rest.rear_groove,
        rest.front_groove,
        mode.region_of(rear - rest.rear_groove * c.body.pitch, c.body.half_clearance),
        mode.region_of(front - rest.front_groove * c.body.pitch, c.body.half_clearance),
    )
    first = int(mode.nearest_groove_of(c.body.initial_length, c.body.pitch))
    grooves = Grooves(rear_grooves, front_grooves, first)
    records = march.Records(np.zeros(march.TOTALS_SIZE), samples, samples[:0])
    run_sampled(breaks, coefficients, motion, c, grooves, records)
    return records.totals[march.FAILURE] == 0.0


@compiled
def step(
    segment: march.Segment,
    motion: mode.Motion,
    c: mode.Constants,
    totals: np.ndarray,
    sample: np.ndarray,
) -> mode.Motion:
    """Return the motion at the end of a segment, and fill ``sample`` (1, SAMPLE_COLUMNS) there; see `march.Records`."""
    totals[march.SAMPLED] = 0.0
    sample[0, march.TIME] = segment.start + segment.duration
    return march.march(segment, motion, c, None, march.Records(totals, sample, sample[:0]))
