# SPDX-License-Identifier: Apache-2.0
"""Closed form of M·ÿ + 2η·ẏ + k·y = forcing, for every kind of roots.

Every quantity of a mode (y, a fin's displacement, the cable force) is a sum over one set of functions with the factors
`Coefficients`. The derivative of a quantity is such a sum, too. σ is the time in the segment, within which the forcing
keeps its form. s is the time in the mode, within which the fins stay in their regions. These are the functions:

    1, σ, σ², σ³          for a piecewise polynomial length
    cos ωσ, sin ωσ, e^qσ  for a gait's length; q = −1/τ
    h1, h2                the free response. Separated real roots: e^(r1·s), e^(r2·s). Joined roots (double, nearly
                          double or complex): e^(−γs)·C(s), e^(−γs)·S(s), see `joined_response`
    R                     the response to the forcing e^(q·s) from rest, used only where q is nearly a root (resonance)
"""

from __future__ import annotations

import math
from typing import NamedTuple

from worm_model.simulation.kernel.compiled import compiled, inlined

_JOINED_BELOW = 1e-3  # |r1 − r2| / (|r1| + |r2|) below which separated roots would lose digits
_RESONANT_BELOW = 1e-5  # |(q − r1)·(q − r2)| / (|q| + γ)² below which R is used
_GONE = -42.0  # exponent below which an exponential is smaller than rounding errors
# distance of q from both roots, relative to |q| + γ, below which R is summed as a series
_SERIES_BELOW = 0.05


class Roots(NamedTuple):
    """Roots −γ ± √D of M·r² + 2η·r + k = 0, 1/s. r1 and r2 are the real roots, or both −γ if the roots are complex."""

    joined: bool
    gamma: float
    discriminant: float
    r1: float
    r2: float


class Coefficients(NamedTuple):
    """Coefficients of a quantity that is a sum over the functions in the module's docstring; ``res`` is that of R."""

    one: float
    t1: float
    t2: float
    t3: float
    cos: float
    sin: float
    exp: float
    h1: float
    h2: float
    res: float


class Basis(NamedTuple):
    """Values of the functions at one moment; ``t1`` is σ, from which σ² and σ³ are computed."""

    t1: float
    cos: float
    sin: float
    exp: float
    h1: float
    h2: float
    res: float


class Wave(NamedTuple):
    """Parameters of the functions: mass M in kg, angular frequency ω in 1/s, and q = −1/τ in 1/s.

    ω is 0 for a length without a sinusoid, and q is 0 for a piecewise polynomial length.
    """

    mass: float
    omega: float
    q: float


@inlined
def roots_of(mass: float, friction: float, stiffness: float) -> Roots:
    """Return the roots of mass·r² + 2·friction·r + stiffness."""
    gamma = friction / mass
    discriminant = gamma * gamma - stiffness / mass
    if discriminant > (_JOINED_BELOW * gamma) ** 2:
        r2 = -gamma - math.sqrt(discriminant)
        return Roots(False, gamma, discriminant, (stiffness / mass) / r2, r2)
    if discriminant > 0.0:
        split = math.sqrt(discriminant)
        return Roots(True, gamma, discriminant, split - gamma, -gamma - split)
    return Roots(True, gamma, discriminant, -gamma, -gamma)


@compiled
def joined_response(s: float, roots: Roots) -> tuple[float, float]:
    """Return (h1, h2) of joined roots: e^(−γs)·(C, S), C' = D·S, S' = C, C(0) = 1, S(0) = 0."""
    if roots.discriminant < 0.0:
        beta = math.sqrt(-roots.discriminant)
        decay = math.exp(-roots.gamma * s)
        return decay * math.cos(beta * s), decay * math.sin(beta * s) / beta
    slow = math.exp(roots.r1 * s)
    gap = roots.r1 - roots.r2
    if gap == 0.0:
        return slow, s * slow
    fast = math.exp(roots.r2 * s)
    return 0.5 * (slow + fast), fast * math.expm1(gap * s) / gap


@compiled
def _difference_quotient(a: float, b: float, s: float) -> float:
    """Return (e^(a·s) − e^(b·s)) / (a − b), also at a = b."""
    if a == b:
        return s * math.exp(a * s)
    low, high = min(a, b), max(a, b)
    return math.exp(high * s) * -math.expm1((low - high) * s) / (high - low)


@compiled
def resonant_response(s: float, roots: Roots, q: float, mass: float) -> float:
    """Return R(s), the response to e^(q·s) from rest, M·R'' + 2η·R' + k·R = e^(q·s).

    R is a divided difference of the exponential function over r1, r2 and q, computed in the order with the least
    cancellation. If q is near both roots, which may be complex, R is summed as a series.
    """
    near, far = roots.r1, roots.r2
    if abs(q - near) > abs(q - far):
        near, far = far, near
    spread = max(abs(q + roots.gamma), math.sqrt(abs(roots.discriminant)))
    if spread > _SERIES_BELOW * (abs(q) + roots.gamma):
        inner = _difference_quotient(q, near, s) - _difference_quotient(near, far, s)
        return inner / (mass * (q - far))
    x = (q + roots.gamma) * s
    z = roots.discriminant * s * s
    symmetric, power, factorial, total = 1.0, 1.0, 2.0, 0.5
    for n in range(1, 60):
        power = power * z if n % 2 == 0 else power
        symmetric = x * symmetric + (power if n % 2 == 0 else 0.0)
        factorial *= n + 2.0
        total += symmetric / factorial
    return s * s * math.exp(-roots.gamma * s) * total / mass


@inlined
def is_resonant(roots: Roots, q: float) -> bool:
    """Return True if q is so near a root that a particular solution e^qσ and the free response would nearly cancel."""
    scale = _RESONANT_BELOW * (abs(q) + abs(roots.gamma)) ** 2
    return abs((q + roots.gamma) ** 2 - roots.discriminant) < scale


@inlined
def derivative(c: Coefficients, roots: Roots, wave: Wave) -> Coefficients:
    """Return the coefficients of the time derivative."""
    if roots.joined:
        h1 = -roots.gamma * c.h1 + c.h2
        h2 = roots.discriminant * c.h1 - roots.gamma * c.h2 + c.res / wave.mass
    else:
        rest = c.res / (wave.mass * (roots.r1 - roots.r2))
        h1 = roots.r1 * c.h1 + rest
        h2 = roots.r2 * c.h2 - rest
    return Coefficients(
        c.t1,
        2.0 * c.t2,
        3.0 * c.t3,
        0.0,
        wave.omega * c.sin,
        -wave.omega * c.cos,
        wave.q * c.exp,
        h1,
        h2,
        wave.q * c.res,
    )


@inlined
def combine(a: float, x: Coefficients, b: float, y: Coefficients) -> Coefficients:
    """Return a·x + b·y."""
    return Coefficients(
        a * x.one + b * y.one,
        a * x.t1 + b * y.t1,
        a * x.t2 + b * y.t2,
        a * x.t3 + b * y.t3,
        a * x.cos + b * y.cos,
        a * x.sin + b * y.sin,
        a * x.exp + b * y.exp,
        a * x.h1 + b * y.h1,
        a * x.h2 + b * y.h2,
        a * x.res + b * y.res,
    )


@inlined
def shifted(c: Coefficients, offset: float) -> Coefficients:
    """Return the quantity plus a constant."""
    return Coefficients(c.one + offset, c.t1, c.t2, c.t3, c.cos, c.sin, c.exp, c.h1, c.h2, c.res)


@inlined
def basis_at(sigma: float, s: float, roots: Roots, wave: Wave, resonant: bool) -> Basis:
    """Return the values of the functions at the times ``sigma`` in the segment and ``s`` in the mode, s."""
    if roots.joined:
        h1, h2 = joined_response(s, roots)
    else:
        h1 = math.exp(roots.r1 * s)
        h2 = math.exp(roots.r2 * s) if roots.r2 * s > _GONE else 0.0
    res = resonant_response(s, roots, wave.q, wave.mass) if resonant else 0.0
    exp = math.exp(wave.q * sigma) if wave.q != 0.0 else 0.0
    if wave.omega == 0.0:
        return Basis(sigma, 0.0, 0.0, exp, h1, h2, res)
    angle = wave.omega * sigma
    return Basis(sigma, math.cos(angle), math.sin(angle), exp, h1, h2, res)


@inlined
def basis_at_start(b: Basis, roots: Roots) -> Basis:
    """Return the values of the functions at the moment of ``b`` in a mode that starts at this moment."""
    return Basis(b.t1, b.cos, b.sin, b.exp, 1.0, 0.0 if roots.joined else 1.0, 0.0)


@inlined
def value(c: Coefficients, b: Basis) -> float:
    """Return the quantity at the moment of the basis."""
    return (
        c.one
        + b.t1 * (c.t1 + b.t1 * (c.t2 + b.t1 * c.t3))
        + c.cos * b.cos
        + c.sin * b.sin
        + c.exp * b.exp
        + c.h1 * b.h1
        + c.h2 * b.h2
        + c.res * b.res
    )
