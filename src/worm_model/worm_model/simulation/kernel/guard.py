# SPDX-License-Identifier: Apache-2.0
"""Search for the first zero of several gaps, without stepping past any.

A guard watches a gap, the distance of a quantity from a border. The gap is positive until the event of the guard. The
gap's value, its rate and bounds on its second derivative define two parabolas between which the gap lies for the time
ahead. The gap is positive at least until the lower parabola reaches zero. When the upper parabola reaches zero, the
event has happened. Between these times the gap has exactly one zero, which Halley's method locates. A gap that only
touches zero, within rounding, triggers no event.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from worm_model.simulation.kernel.compiled import compiled, inlined
from worm_model.simulation.kernel.linear import (
    Basis,
    Coefficients,
    Roots,
    Wave,
    basis_at,
    derivative,
    value,
)

NOTHING, REAR_HIGH, REAR_LOW, FRONT_HIGH, FRONT_LOW, FORCE_SIGN, RATE_SIGN, END = range(8)
# Beyond END: dry friction, see `worm_model.simulation.kernel.dry_friction`
REAR_GRIP_HIGH, REAR_GRIP_LOW, FRONT_GRIP_HIGH, FRONT_GRIP_LOW = range(8, 12)

SHORTEST_STEP = 1e-10  # s; step that guarantees progress where a gap is zero and grows
# m, or N and m/s for the signs of F_c and L̇. A gap that falls below 0 by at most TOUCH triggers no event, so that
# rounding alone triggers none.
TOUCH = 1e-13
SIMULTANEOUS = 1e-11  # s; of two events that are closer than this, the one whose guard is read first comes first
MOST_NEWTON_STEPS = 50  # limit of the iterations of Halley's method
# s, or the unit of a border. It replaces infinity, which compiled code may not contain, see
# `worm_model.simulation.kernel.compiled`.
NEVER = 1e300


class Followed(NamedTuple):
    """Quantity ``position`` in a mode, its two derivatives, and the amplitude of the sinusoid in ``acceleration``."""

    position: Coefficients
    rate: Coefficients
    acceleration: Coefficients
    amplitude: float


class Reading(NamedTuple):
    """Present value and rate of a quantity or a gap, and bounds of its second derivative for the time ahead."""

    position: float
    rate: float
    least: float
    most: float


class Horizon(NamedTuple):
    """Bounds on the next event, in s from the present moment.

    No event happens before ``earliest``. The event ``stop`` happens at ``time`` at the latest. If ``stop`` is NOTHING
    or END, no event happens until ``time``. With NOTHING the search continues from there; with END the segment ends.
    """

    earliest: float
    time: float
    stop: int


@inlined
def follow(position: Coefficients, roots: Roots, wave: Wave) -> Followed:
    """Return a quantity with the derivatives that guards need to follow it over a mode."""
    rate = derivative(position, roots, wave)
    acceleration = derivative(rate, roots, wave)
    amplitude = math.sqrt(acceleration.cos**2 + acceleration.sin**2)
    return Followed(position, rate, acceleration, amplitude)


@inlined
def _greatest(power: float, rate: float, s: float, end: float) -> float:
    """Return the greatest value of t^power·e^(rate·t) over the times [s, end] in s, for a rate in 1/s of at most 0."""
    t = min(max(s, -power / rate), end) if rate < 0.0 else end
    return t**power * math.exp(rate * t)


@compiled
def _coarse_swing(c: Coefficients, s: float, end: float, roots: Roots, wave: Wave) -> float:
    """Return a bound on the absolute value of the h1, h2 and R terms over the times [s, end] in the mode, s.

    It is used for joined roots and for resonance, which are rare. R is a divided difference of e^(x·t) over r1, r2 and
    q. Such a difference over two numbers is at most t·e^(slowest·t), and over three numbers t²/2·e^(slowest·t).
    """
    if not roots.joined:
        swing = abs(c.h1) * math.exp(roots.r1 * s) + abs(c.h2) * math.exp(roots.r2 * s)
    else:
        slow, longest = math.exp(roots.r1 * s), _greatest(1.0, roots.r1, s, end)
        if roots.discriminant < 0.0:
            longest = min(longest, slow / math.sqrt(-roots.discriminant))
        swing = abs(c.h1) * slow + abs(c.h2) * longest
    if c.res == 0.0:
        return swing
    slowest = max(roots.r1, wave.q)
    response = 0.5 * _greatest(2.0, slowest, s, end)
    spread = max(abs(wave.q + roots.gamma), math.sqrt(abs(roots.discriminant)))
    if spread > 0.0:
        response = min(response, 2.0 * _greatest(1.0, slowest, s, end) / spread)
    return swing + abs(c.res) * response / wave.mass


@inlined
def read(
    f: Followed, b: Basis, s: float, left: float, roots: Roots, wave: Wave, coarse: bool
) -> Reading:
    """Return a quantity at the moment of the basis ``b``, with bounds for the next ``left`` seconds.

    ``s`` is the time in the mode, s. ``coarse`` is True for joined roots or resonance, for which wider bounds are used.
    """
    c = f.acceleration
    if wave.q != 0.0:
        decaying = c.exp * b.exp
        least = c.one + min(decaying, 0.0) - f.amplitude
        most = c.one + max(decaying, 0.0) + f.amplitude
    else:
        end = b.t1 + left  # the acceleration of a cubic is linear
        here, there = c.one + c.t1 * b.t1, c.one + c.t1 * end
        least, most = min(here, there), max(here, there)
    if coarse:
        swing = _coarse_swing(c, s, s + left, roots, wave)
        least, most = least - swing, most + swing
    else:
        slow, fast = c.h1 * b.h1, c.h2 * b.h2
        least += min(slow, 0.0) + min(fast, 0.0)
        most += max(slow, 0.0) + max(fast, 0.0)
    return Reading(value(f.position, b), value(f.rate, b), least, most)


@inlined
def below(r: Reading, border: float) -> Reading:
    """Return the gap between a quantity and a border above it."""
    return Reading(border - r.position, -r.rate, -r.most, -r.least)


@inlined
def above(r: Reading, border: float) -> Reading:
    """Return the gap between a quantity and a border below it."""
    return Reading(r.position - border, r.rate, r.least, r.most)


@compiled
def _enclosure(gap: float, rate: float, least: float, most: float) -> tuple[float, float]:
    """Return the earliest and latest time (s from now) of a gap's zero. The latest is NEVER if no zero is certain."""
    discriminant = rate * rate - 2.0 * least * gap
    if rate >= 0.0:
        return ((rate + math.sqrt(discriminant)) / -least if least < 0.0 else NEVER), NEVER
    earliest = 2.0 * gap / (math.sqrt(discriminant) - rate)
    discriminant = rate * rate - 2.0 * most * gap
    if discriminant <= 0.0:
        return earliest, NEVER
    return earliest, 2.0 * gap / (math.sqrt(discriminant) - rate)


@inlined
def narrow(ahead: Horizon, gap: Reading, stop: int) -> Horizon:
    """Return the bounds on the next event, narrowed by the guard of one more gap; ``stop`` is the guard's event."""
    h, least = ahead.time, min(gap.least, 0.0)
    if gap.position + h * (gap.rate + 0.5 * least * h) >= -TOUCH:
        return ahead
    earliest, latest = _enclosure(max(gap.position, 0.0), gap.rate, least, max(gap.most, 0.0))
    if earliest > h:
        return ahead
    if ahead.stop == NOTHING or ahead.stop == END:
        if latest <= h:
            return Horizon(earliest, latest, stop)
        return Horizon(earliest, earliest, NOTHING)
    if latest < ahead.earliest:
        return Horizon(earliest, latest, stop)
    if max(latest, h) - min(earliest, ahead.earliest) < SIMULTANEOUS:
        return ahead
    first = min(earliest, ahead.earliest)
    return Horizon(first, first, NOTHING)


@inlined
def locate(
    f: Followed,
    border: float,
    tolerance: float,
    s: float,
    b: Basis,
    ahead: Horizon,
    offset: float,
    roots: Roots,
    wave: Wave,
    resonant: bool,
) -> tuple[float, Basis]:
    """Return (time in the mode in s, basis) at which a quantity meets the border, which happens once within ``ahead``.

    ``s`` is the present time in the mode, ``b`` the basis at this time, and ``offset`` the start of the mode in its
    segment, s. ``tolerance`` is the accuracy in the unit of the quantity. Halley's method starts where a parabola with
    the present value and derivatives of the quantity would meet the border.
    """
    low, high = s + ahead.earliest, s + ahead.time
    gap, rate, bend = value(f.position, b) - border, value(f.rate, b), value(f.acceleration, b)
    reach = math.sqrt(max(rate * rate - 2.0 * bend * gap, 0.0))
    reach += abs(rate)
    step = 2.0 * abs(gap) / reach if reach > 0.0 else 0.0
    at = min(max(s + step, low), high)
    for _ in range(MOST_NEWTON_STEPS):
        b = basis_at(offset + at, at, roots, wave, resonant)
        gap, rate = value(f.position, b) - border, value(f.rate, b)
        if abs(gap) <= tolerance or rate == 0.0:
            break
        step = gap / rate
        bend = 0.5 * step * value(f.acceleration, b) / rate
        at = min(max(at - step * (1.0 + bend), low), high)
    else:  # Rounding exceeds the tolerance.
        b = basis_at(offset + at, at, roots, wave, resonant)
    return at, b
