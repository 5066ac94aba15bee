# SPDX-License-Identifier: Apache-2.0
"""Dry (Coulomb) friction of the modules, exact. Events separate the modes in which a module slides or sticks.

A constant force D opposes a module that slides. A module that sticks does not move, so that ΔL alone moves the other
module. The sticking module slides again when the force that friction must hold exceeds D. Both modules can stick only
while ΔL is constant. At the start of each mode, the velocity of a module decides whether it slides or sticks. If the
velocity is zero, the forces decide.

The tolerances `STILL` and `SPARE` prevent that rounding switches a module between sliding and sticking without end. The
mode of a sliding module ends when its velocity has passed zero by STILL, and velocities up to 2·STILL then count as
zero. The mode of a sticking module ends when the force exceeds D by 2·SPARE, and it then slides, because the force
exceeds D by more than SPARE.
"""

from __future__ import annotations

from typing import NamedTuple

from worm_model.simulation.kernel import guard
from worm_model.simulation.kernel.compiled import compiled, inlined
from worm_model.simulation.kernel.linear import (
    Basis,
    Coefficients,
    Wave,
    combine,
    derivative,
    roots_of,
    shifted,
    value,
)
from worm_model.simulation.kernel.mode import (
    Constants,
    Mode,
    Motion,
    cable_force,
    enter_mode,
    fin_force,
    fin_stiffness,
    mode_of,
    moved,
)

STILL = 1e-11  # m/s
SPARE = 1e-9  # N
LOCATED = 0.1  # accuracy with which the end of a mode is located, as a fraction of STILL or SPARE


class Grip(NamedTuple):
    """State of dry friction of both modules: the sign of the velocity if a module slides, 0 if it sticks."""

    rear: int
    front: int


@inlined
def _sign(value: float) -> int:
    return 1 if value > 0.0 else -1


@inlined
def _from_rest(load: float, stretch: int, apart: float, c: Constants) -> Grip:
    """Return the grip of two modules at rest.

    ``load`` in N is the force on both modules together if the rear module stays at rest. If the front module stays at
    rest instead, this force is ``load + stretch·apart``. ``stretch`` is the sign of L̇ from now on (0: ΔL is constant).
    ``apart`` can be negative only if the rate of ΔL decays or is about to reverse. If ΔL changes, at least one module
    moves. The larger the force in the direction of ``stretch``, the more modules move in this direction: first none,
    then one, then both.
    """
    both = c.resistance.rear_dry + c.resistance.front_dry
    if stretch == 0:
        side = 0 if abs(load) <= both + SPARE else _sign(load)
        return Grip(side, side)
    along = stretch * load
    if along > both + SPARE:
        return Grip(stretch, stretch)
    if along >= c.resistance.front_dry - c.resistance.rear_dry - SPARE:
        return Grip(0, stretch)
    if along > c.resistance.front_dry - c.resistance.rear_dry - apart + SPARE:
        return Grip(-stretch, stretch)
    if along >= -both - apart - SPARE:
        return Grip(-stretch, 0)
    return Grip(-stretch, -stretch)


@compiled
def _judge(
    motion: Motion, length_change: Coefficients, wave: Wave, c: Constants, b: Basis
) -> tuple[Grip, float]:
    """Return (the grip from now on, ẏ). If a module rests, ẏ is computed from L̇ alone, without a rounding error."""
    roots = roots_of(c.body.mass, c.body.friction, 0.0)
    rate_form = derivative(length_change, roots, wave)
    bend_form = derivative(rate_form, roots, wave)
    change, rate, bend = value(length_change, b), value(rate_form, b), value(bend_form, b)
    rear_velocity = motion.rate - c.body.mu * rate
    front_velocity = rear_velocity + rate
    rear = motion.y - c.body.mu * change - motion.rear_groove * c.body.pitch
    front = (
        motion.y
        + (1.0 - c.body.mu) * change
        + c.body.initial_length
        - motion.front_groove * c.body.pitch
    )
    rear -= (motion.rear_region - 1.0) * c.body.half_clearance
    front -= (motion.front_region - 1.0) * c.body.half_clearance
    fins = (
        fin_stiffness(motion.rear_region, c.rear_fin) * rear
        + fin_stiffness(motion.front_region, c.front_fin) * front
    )
    load = (
        -fins - c.resistance.load - c.body.friction * rate - (c.body.mass - c.body.rear_mass) * bend
    )
    # Amount by which the force is larger if the front module stays at rest instead of the rear one
    moved = 2.0 * c.body.friction * rate + c.body.mass * bend
    rear_rests = c.resistance.rear_dry > 0.0 and abs(rear_velocity) <= 2.0 * STILL
    front_rests = c.resistance.front_dry > 0.0 and abs(front_velocity) <= 2.0 * STILL
    if rear_rests and front_rests:
        turn = rate
        if turn == 0.0:
            turn = bend if bend != 0.0 else value(derivative(bend_form, roots, wave), b)
        stretch = 0 if turn == 0.0 else _sign(turn)
        grip = _from_rest(load, stretch, stretch * moved, c)
        # If both modules begin to slide to the same side, one still has the velocity 0, and the other one has |L̇|.
        rear_waits = grip.rear == 0 or (grip.front != 0 and grip.front == stretch)
        return grip, (c.body.mu if rear_waits else c.body.mu - 1.0) * rate
    if rear_rests:
        side = _sign(front_velocity)
        load -= c.resistance.front_dry * side
        return Grip(
            0 if abs(load) <= c.resistance.rear_dry + SPARE else _sign(load), side
        ), c.body.mu * rate
    side = _sign(rear_velocity)
    if front_rests:
        load += moved - c.resistance.rear_dry * side
        own = 0 if abs(load) <= c.resistance.front_dry + SPARE else _sign(load)
        return Grip(side, own), (c.body.mu - 1.0) * rate
    return Grip(side, _sign(front_velocity)), motion.rate


@inlined
def _held(mode: Mode, grip: Grip, motion: Motion, wave: Wave, c: Constants) -> Coefficients:
    """Return the force in N that dry friction must hold: on the module that sticks, or on both if both stick."""
    rate = derivative(mode.length_change, mode.roots, wave)
    bend = derivative(rate, mode.roots, wave)
    fins = combine(
        -1.0,
        fin_force(mode.rear, motion.rear_region, c.rear_fin, c.body.half_clearance),
        -1.0,
        fin_force(mode.front, motion.front_region, c.front_fin, c.body.half_clearance),
    )
    if grip.rear == 0:
        moved = combine(-c.body.friction, rate, c.body.rear_mass - c.body.mass, bend)
        return shifted(
            combine(1.0, fins, 1.0, moved), -c.resistance.front_dry * grip.front - c.resistance.load
        )
    moved = combine(c.body.friction, rate, c.body.rear_mass, bend)
    return shifted(
        combine(1.0, fins, 1.0, moved), -c.resistance.rear_dry * grip.rear - c.resistance.load
    )


@compiled
def enter_dry_mode(
    motion: Motion, length_change: Coefficients, wave: Wave, c: Constants, start: Basis
) -> tuple[Mode, Coefficients, Grip]:
    """Return (the mode that begins with ``motion``, F_c in this mode, the grip in this mode).

    Of the basis ``start``, only the functions of σ are used (see `kernel.linear`). If both modules stick, the
    distribution of the friction over them is statically indeterminate. It is assumed to be proportional to their dry
    frictions. No work depends on this assumption, because ΔL is constant.
    """
    grip, rate = _judge(motion, length_change, wave, c, start)
    motion = moved(motion, motion.y, rate)
    push = -(c.resistance.rear_dry * grip.rear + c.resistance.front_dry * grip.front)
    mode = enter_mode(motion, length_change, wave, c, start, push)
    if grip.rear == 0 or grip.front == 0:
        share = c.body.mu if grip.rear == 0 else c.body.mu - 1.0
        rest = motion.y - share * value(length_change, start)
        y = shifted(combine(share, length_change, 0.0, length_change), rest)
        mode = mode_of(
            y, length_change, motion, roots_of(c.body.mass, c.body.friction, 0.0), False, c
        )
    force = cable_force(mode, motion.rear_region, wave, c)
    if grip.rear != 0:
        return mode, shifted(force, c.resistance.rear_dry * grip.rear), grip
    own = (
        1.0
        if grip.front != 0
        else c.resistance.rear_dry / (c.resistance.rear_dry + c.resistance.front_dry)
    )
    return mode, combine(1.0, force, own, _held(mode, grip, motion, wave, c)), grip


@inlined
def _watched(
    at_front: bool, mode: Mode, grip: Grip, motion: Motion, wave: Wave, c: Constants
) -> tuple[Coefficients, float, float]:
    """Return (the quantity that decides on a module's grip, its lower and upper limit, at which the mode ends).

    A limit of ±NEVER has no effect.
    """
    side = grip.front if at_front else grip.rear
    dry = c.resistance.front_dry if at_front else c.resistance.rear_dry
    together = grip.rear == 0 and grip.front == 0
    if dry == 0.0 or (together and at_front):
        return mode.rear, -guard.NEVER, guard.NEVER
    if side == 0:
        limit = 2.0 * SPARE + (c.resistance.rear_dry + c.resistance.front_dry if together else dry)
        return _held(mode, grip, motion, wave, c), -limit, limit
    y_rate = derivative(mode.y, mode.roots, wave)
    rate = derivative(mode.length_change, mode.roots, wave)
    velocity = combine(1.0, y_rate, 1.0 - c.body.mu if at_front else -c.body.mu, rate)
    return velocity, (-STILL if side > 0 else -guard.NEVER), (STILL if side < 0 else guard.NEVER)


@compiled
def look_for_grip(
    ahead: guard.Horizon,
    mode: Mode,
    grip: Grip,
    motion: Motion,
    b: Basis,
    s: float,
    left: float,
    wave: Wave,
    c: Constants,
) -> guard.Horizon:
    """Return the bounds on the next event, narrowed by the next changes of the modules' grips.

    ``s`` is the time in the mode, ``b`` the basis at this time, and ``left`` the rest of the segment, s.
    """
    coarse = mode.roots.joined or mode.resonant
    for at_front in (False, True):
        watched, low, high = _watched(at_front, mode, grip, motion, wave, c)
        followed = guard.follow(watched, mode.roots, wave)
        reading = guard.read(followed, b, s, left, mode.roots, wave, coarse)
        if high < guard.NEVER:
            stop = guard.FRONT_GRIP_HIGH if at_front else guard.REAR_GRIP_HIGH
            ahead = guard.narrow(ahead, guard.below(reading, high), stop)
        if low > -guard.NEVER:
            stop = guard.FRONT_GRIP_LOW if at_front else guard.REAR_GRIP_LOW
            ahead = guard.narrow(ahead, guard.above(reading, low), stop)
    return ahead


@compiled
def locate_grip(
    ahead: guard.Horizon,
    mode: Mode,
    grip: Grip,
    motion: Motion,
    b: Basis,
    s: float,
    offset: float,
    wave: Wave,
    c: Constants,
) -> tuple[float, Basis]:
    """Return (time in the mode in s, basis) at which a grip changes; for the arguments see `guard.locate`."""
    at_front = ahead.stop in (guard.FRONT_GRIP_HIGH, guard.FRONT_GRIP_LOW)
    watched, low, high = _watched(at_front, mode, grip, motion, wave, c)
    border = high if ahead.stop in (guard.REAR_GRIP_HIGH, guard.FRONT_GRIP_HIGH) else low
    sticks = (grip.front if at_front else grip.rear) == 0
    tolerance = LOCATED * (SPARE if sticks else STILL)
    followed = guard.follow(watched, mode.roots, wave)
    return guard.locate(
        followed, border, tolerance, s, b, ahead, offset, mode.roots, wave, mode.resonant
    )
