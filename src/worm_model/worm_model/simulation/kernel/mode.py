# SPDX-License-Identifier: Apache-2.0
"""One mode: the fins stay in their regions, so every quantity has a closed form until the next event.

The state is the pseudo-position y = x1 + μ·ΔL with its rate, where μ = M2 / M and M = M1 + M2. With y, the reduced
dynamics (eq:continuous_model) contain no second derivative of the length:

    M·ÿ + 2η·ẏ = (2μ − 1)·η·L̇ − f(x1 − A1) − f(x2 − A2) − Q1 − Q2

The forces of the fins and of the cable (eq:fin_force_piecewise, eq:Fc) have closed forms, too.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from worm_model.simulation.kernel.compiled import inlined
from worm_model.simulation.kernel.linear import (
    Basis,
    Coefficients,
    Roots,
    Wave,
    combine,
    derivative,
    is_resonant,
    roots_of,
    shifted,
    value,
)

BELOW, CLEAR, ABOVE = 0, 1, 2  # region of a fin's deflection: below, within or above the clearance


class Fin(NamedTuple):
    """Parameters of a fin. The stiffness of each region depends on the direction of the robot."""

    stiffness_below: float
    stiffness_above: float
    threshold: float


class Body(NamedTuple):
    """Parameters of the body and of its pipe in SI units; for the meaning see docs/model.md.

    ``mass`` is M1 + M2, ``mu`` is M2 / (M1 + M2), ``friction`` is η.
    """

    mass: float
    mu: float
    friction: float
    half_clearance: float
    pitch: float
    initial_length: float
    rear_mass: float
    bellows_stiffness: float
    bellows_damping: float
    unstressed_length: float
    one_sided_cable: bool


class Resistance(NamedTuple):
    """Forces in N that do not depend on the position or on the magnitude of a velocity."""

    rear_dry: float
    front_dry: float
    rear_load: float
    load: float  # sum of both modules' loads


class Constants(NamedTuple):
    """Parameters of a robot as the kernel uses them. Where grooves differ, only the fins are replaced."""

    body: Body
    rear_fin: Fin
    front_fin: Fin
    resistance: Resistance


class Motion(NamedTuple):
    """State between events: y in m, ẏ in m/s, the anchors as numbers of grooves, the regions of the fins."""

    y: float
    rate: float
    rear_groove: int
    front_groove: int
    rear_region: int
    front_region: int


@inlined
def moved(motion: Motion, y: float, rate: float) -> Motion:
    """Return a motion with other y and ẏ."""
    return Motion(
        y, rate, motion.rear_groove, motion.front_groove, motion.rear_region, motion.front_region
    )


class Mode(NamedTuple):
    """Closed form of a mode: y, ΔL, displacements x − A of both fins, and the roots on which the functions depend.

    ``resonant`` is True if y contains the response R, see `kernel.linear`.
    """

    y: Coefficients
    length_change: Coefficients
    rear: Coefficients
    front: Coefficients
    roots: Roots
    resonant: bool


def nearest_groove(length: Any, pitch: Any) -> Any:
    """Return the number of the groove nearest to the front module at a body length in m, with the rear module at 0.

    Halfway between two grooves, the lower number is returned. The arguments are numbers or, outside the kernel, arrays.
    The result is a whole number as a float.
    """
    return np.ceil(length / pitch - 0.5 - 1e-12)


nearest_groove_of = inlined(nearest_groove)  # For numbers, within the kernel


@inlined
def region_of(displacement: float, half_clearance: float) -> int:
    """Return the region of a fin displacement x − A; the borders belong to the clearance (eq:fin_force_piecewise)."""
    if displacement > half_clearance:
        return ABOVE
    return BELOW if displacement < -half_clearance else CLEAR


@inlined
def fin_stiffness(region: int, fin: Fin) -> float:
    """Return the stiffness of a fin in its region, N/m."""
    if region == CLEAR:
        return 0.0
    return fin.stiffness_below if region == BELOW else fin.stiffness_above


@inlined
def fin_force(
    displacement: Coefficients, region: int, fin: Fin, half_clearance: float
) -> Coefficients:
    """Return the force f of a fin that stays in its region (eq:fin_force_piecewise)."""
    k = fin_stiffness(region, fin)
    touched = shifted(displacement, -(region - 1.0) * half_clearance)
    return combine(k, touched, 0.0, touched)


@inlined
def _polynomial_response(
    g: Coefficients, k: float, friction: float, mass: float
) -> tuple[float, float, float, float]:
    """Return the coefficients of the polynomial response to the polynomial part of the forcing g, constant term first.

    ``k`` is the stiffness of both fins together, N/m.
    """
    if k > 0.0:
        p3 = g.t3 / k
        p2 = (g.t2 - 6.0 * friction * p3) / k
        p1 = (g.t1 - 4.0 * friction * p2 - 6.0 * mass * p3) / k
        return (g.one - 2.0 * friction * p1 - 2.0 * mass * p2) / k, p1, p2, p3
    # Both fins in clearance: the forcing consists of the length rate and constant forces, so it is at most quadratic.
    p3 = g.t2 / (6.0 * friction)
    p2 = (g.t1 - 6.0 * mass * p3) / (4.0 * friction)
    return 0.0, (g.one - 2.0 * mass * p2) / (2.0 * friction), p2, p3


@inlined
def _particular(
    g: Coefficients, k: float, c: Constants, wave: Wave, resonant: bool, start: Basis
) -> Coefficients:
    """Return a particular response to the forcing g. If q is resonant, it contains R, which starts from rest."""
    p0, p1, p2, p3 = _polynomial_response(g, k, c.body.friction, c.body.mass)
    in_phase = k - c.body.mass * wave.omega * wave.omega
    in_quadrature = 2.0 * c.body.friction * wave.omega
    cos, sin, exp, res = 0.0, 0.0, 0.0, 0.0
    if wave.omega != 0.0:
        norm = in_phase * in_phase + in_quadrature * in_quadrature
        cos = (g.cos * in_phase - g.sin * in_quadrature) / norm
        sin = (g.sin * in_phase + g.cos * in_quadrature) / norm
    if wave.q != 0.0:
        if resonant:
            res = g.exp * start.exp
        else:
            exp = g.exp / (c.body.mass * wave.q * wave.q + 2.0 * c.body.friction * wave.q + k)
    return Coefficients(p0, p1, p2, p3, cos, sin, exp, 0.0, 0.0, res)


@inlined
def _free(y: float, rate: float, roots: Roots) -> tuple[float, float]:
    """Return the coefficients of h1, h2 for a free response that starts at y with ẏ = rate."""
    if roots.joined:
        return y, rate + roots.gamma * y
    gap = roots.r1 - roots.r2
    return (rate - roots.r2 * y) / gap, (roots.r1 * y - rate) / gap


@inlined
def mode_of(
    y: Coefficients,
    length_change: Coefficients,
    motion: Motion,
    roots: Roots,
    resonant: bool,
    c: Constants,
) -> Mode:
    """Return the mode with these y and ΔL, and the fin displacements that follow from them."""
    rear = shifted(combine(1.0, y, -c.body.mu, length_change), -motion.rear_groove * c.body.pitch)
    offset = c.body.initial_length - motion.front_groove * c.body.pitch
    front = shifted(combine(1.0, y, 1.0 - c.body.mu, length_change), offset)
    return Mode(y, length_change, rear, front, roots, resonant)


@inlined
def enter_mode(
    motion: Motion,
    length_change: Coefficients,
    wave: Wave,
    c: Constants,
    start: Basis,
    push: float,
) -> Mode:
    """Return the mode that begins with ``motion``.

    Of the basis ``start``, only the functions of σ are used (see `kernel.linear`). ``push`` in N is the constant dry
    friction on the modules that slide, positive towards +x.
    """
    rear_k = fin_stiffness(motion.rear_region, c.rear_fin)
    front_k = fin_stiffness(motion.front_region, c.front_fin)
    rear_anchor = motion.rear_groove * c.body.pitch
    front_anchor = motion.front_groove * c.body.pitch
    k = rear_k + front_k
    roots = roots_of(c.body.mass, c.body.friction, k)
    resonant = wave.q != 0.0 and is_resonant(roots, wave.q)
    length_rate = derivative(length_change, roots, wave)
    forcing = combine(
        (2.0 * c.body.mu - 1.0) * c.body.friction,
        length_rate,
        rear_k * c.body.mu - front_k * (1.0 - c.body.mu),
        length_change,
    )
    rear_rest = rear_anchor + (motion.rear_region - 1.0) * c.body.half_clearance
    front_rest = (
        front_anchor + (motion.front_region - 1.0) * c.body.half_clearance - c.body.initial_length
    )
    forcing = shifted(forcing, rear_k * rear_rest + front_k * front_rest + push - c.resistance.load)
    p = _particular(forcing, k, c, wave, resonant, start)
    p_rate = derivative(p, roots, wave)
    # R and its rate are 0 at the start of the mode, so only the functions of σ contribute to the initial values.
    moment = Basis(start.t1, start.cos, start.sin, start.exp, 0.0, 0.0, 0.0)
    y0, rate0 = value(p, moment), value(p_rate, moment)
    h1, h2 = _free(motion.y - y0, motion.rate - rate0, roots)
    y = Coefficients(p.one, p.t1, p.t2, p.t3, p.cos, p.sin, p.exp, h1, h2, p.res)
    return mode_of(y, length_change, motion, roots, resonant, c)


@inlined
def cable_force(mode: Mode, rear_region: int, wave: Wave, c: Constants) -> Coefficients:
    """Return F_c in N in a mode (eq:Fc), without dry friction."""
    length_rate = derivative(mode.length_change, mode.roots, wave)
    x1 = combine(1.0, mode.y, -c.body.mu, mode.length_change)
    x1_rate = derivative(x1, mode.roots, wave)
    x1_acceleration = derivative(x1_rate, mode.roots, wave)
    inertial = combine(c.body.rear_mass, x1_acceleration, c.body.friction, x1_rate)
    body = combine(
        -c.body.bellows_stiffness, mode.length_change, -c.body.bellows_damping, length_rate
    )
    constant = (
        c.body.bellows_stiffness * (c.body.unstressed_length - c.body.initial_length)
        + c.resistance.rear_load
    )
    body = shifted(body, constant)
    held = combine(1.0, inertial, 1.0, body)
    fin = fin_force(mode.rear, rear_region, c.rear_fin, c.body.half_clearance)
    return combine(1.0, held, 1.0, fin)
