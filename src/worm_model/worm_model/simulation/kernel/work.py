# SPDX-License-Identifier: Apache-2.0
"""Mechanical power of the cable (eq:power_model), and the antiderivative of F_c·L̇ over a mode, in closed form.

The functions (1, σ, cos ωσ, e^qσ, h1, h2, R) and the kinds of roots are those of `kernel.linear`. The wave terms are
those with cos ωσ, sin ωσ and e^qσ. r and f are the coefficients of the rate L̇ and of the force F_c. ∫ denotes an
antiderivative with respect to time (in seconds), evaluated at the moment of the basis b.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from worm_model.simulation.kernel.compiled import inlined
from worm_model.simulation.kernel.linear import Basis, Coefficients, Roots, Wave

_SLOW = (
    -1.0
)  # 1/s; root above which integration by parts, which divides by its square, loses digits


def cable_power(force: Any, rate: Any, one_sided_cable: Any) -> Any:
    """Return the mechanical power of the cable, max(−F_c·L̇, 0), W. A one-sided cable has none where F_c < 0.

    ``force`` F_c in N and ``rate`` L̇ in m/s are numbers or, outside the kernel, arrays.
    """
    if one_sided_cable:
        force = np.maximum(force, 0.0)
    return np.maximum(-force * rate, 0.0)


cable_power_of = inlined(cable_power)  # For numbers, within the kernel


@inlined
def _wave_products(r: Coefficients, f: Coefficients, b: Basis, wave: Wave) -> float:
    """Return ∫ of the wave terms of the rate r times those of the force f."""
    w, q = wave.omega, wave.q
    exponential = r.exp * f.exp * b.exp * b.exp / (2.0 * q)
    if w == 0.0:
        return exponential
    squares = 0.5 * (r.cos * f.cos + r.sin * f.sin) * b.t1
    double = 0.5 * (r.cos * f.cos - r.sin * f.sin) * b.sin * b.cos
    double += 0.5 * (r.cos * f.sin + r.sin * f.cos) * b.sin * b.sin
    decaying_cos = r.cos * f.exp + r.exp * f.cos
    decaying_sin = r.sin * f.exp + r.exp * f.sin
    mixed = decaying_cos * (q * b.cos + w * b.sin) + decaying_sin * (q * b.sin - w * b.cos)
    return squares + double / w + mixed * b.exp / (q * q + w * w) + exponential


@inlined
def _separated_products(
    r: Coefficients, f: Coefficients, b: Basis, wave: Wave, roots: Roots
) -> float:
    """Return ∫ of (wave terms of the rate) · (f.h1·e^(r1·s) + f.h2·e^(r2·s)); r1 and r2 are the roots."""
    w = wave.omega
    total = 0.0
    for root, response in ((roots.r1, f.h1 * b.h1), (roots.r2, f.h2 * b.h2)):
        turning = 0.0
        if w != 0.0:
            cos = (r.cos * root - r.sin * w) * b.cos
            sin = (r.cos * w + r.sin * root) * b.sin
            turning = (cos + sin) / (root * root + w * w)
        total += response * (turning + r.exp * b.exp / (wave.q + root))
    return total


@inlined
def _rotated(z: complex, factor: complex, h1: float, h2: float, b: Basis, roots: Roots) -> float:
    """Return Re ∫ of a factor times the free response with the coefficients ``h1`` and ``h2``, for joined roots.

    ``factor`` is the value at ``b`` of a function whose derivative is z times itself.
    """
    p = z - roots.gamma
    det = p * p - roots.discriminant
    a1 = (p * h1 - h2) / det
    a2 = (p * h2 - roots.discriminant * h1) / det
    return (factor * (a1 * b.h1 + a2 * b.h2)).real


@inlined
def _joined_products(r: Coefficients, f: Coefficients, b: Basis, wave: Wave, roots: Roots) -> float:
    """Return ∫ of (wave terms of the rate) · (f.h1·h1 + f.h2·h2), for joined roots."""
    turning = (r.cos - 1j * r.sin) * (b.cos + 1j * b.sin)
    decaying = complex(r.exp * b.exp, 0.0)
    return _rotated(complex(0.0, wave.omega), turning, f.h1, f.h2, b, roots) + _rotated(
        complex(wave.q, 0.0), decaying, f.h1, f.h2, b, roots
    )


@inlined
def _resonant_products(
    r: Coefficients, f: Coefficients, b: Basis, wave: Wave, roots: Roots
) -> float:
    """Return ∫ of the wave terms of the rate times f.res·R, by integration by parts.

    R is the response to e^(q·s) from rest. It satisfies R′ = q·R + S/M, where S is the free response with S = 0 and
    S′ = 1 at the start of the mode.
    """
    turning = (r.cos - 1j * r.sin) * (b.cos + 1j * b.sin)
    decaying = r.exp * b.exp
    z = complex(0.0, wave.omega) + wave.q
    total = (turning / z).real * b.res + decaying * b.res / (2.0 * wave.q)
    # The remaining term is −(1/M)·∫ W·S, where W consists of the wave terms of the rate, each divided by the sum
    # (exponent + q); the exponent is iω or q. The functions for the free response integrate it.
    turned = (r.cos - 1j * r.sin) / z
    scaled = Coefficients(
        0.0, 0.0, 0.0, 0.0, turned.real, -turned.imag, r.exp / (2.0 * wave.q), 0.0, 0.0, 0.0
    )
    if roots.joined:
        free = Coefficients(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0)
        return f.res * (total - _joined_products(scaled, free, b, wave, roots) / wave.mass)
    gap = roots.r1 - roots.r2
    free = Coefficients(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0 / gap, -1.0 / gap, 0.0)
    return f.res * (total - _separated_products(scaled, free, b, wave, roots) / wave.mass)


@inlined
def _line_times_slow(p0: float, p1: float, root: float, s: float) -> float:
    """Return ∫ (p0 + p1·s)·e^(root·s) from 0 to s, also for a root of 0 or near 0."""
    x = root * s
    if abs(x) > 1.0:
        return (math.exp(x) * (p0 + p1 * s - p1 / root) - p0 + p1 / root) / root
    constant, linear, term = 0.0, 0.0, 1.0
    for n in range(1, 20):
        constant += term / n
        linear += term / (n + 1.0)
        term *= x / n
    return s * (p0 * constant + p1 * s * linear)


@inlined
def _line_times_free(
    p0: float, p1: float, h1: float, h2: float, b: Basis, s: float, roots: Roots
) -> float:
    """Return ∫ (p0 + p1·σ) times the free response with the coefficients h1 and h2, by integration by parts."""
    line = p0 + p1 * b.t1
    if roots.joined:
        det = roots.discriminant - roots.gamma * roots.gamma
        a1, a2 = (roots.gamma * h1 + h2) / det, (roots.discriminant * h1 + roots.gamma * h2) / det
        b1, b2 = (roots.gamma * a1 + a2) / det, (roots.discriminant * a1 + roots.gamma * a2) / det
        return (line * a1 - p1 * b1) * b.h1 + (line * a2 - p1 * b2) * b.h2
    total = h2 * b.h2 * (line - p1 / roots.r2) / roots.r2
    if roots.r1 > _SLOW:
        return total + h1 * _line_times_slow(line - p1 * s, p1, roots.r1, s)
    return total + h1 * b.h1 * (line - p1 / roots.r1) / roots.r1


@inlined
def _polynomial_products(
    r: Coefficients, f: Coefficients, b: Basis, s: float, wave: Wave, roots: Roots
) -> float:
    """Return ∫ of the products of rate and force that `_wave_products` and the others with wave terms do not contain.

    These are the polynomial of the rate (constant and linear terms) times all terms of the force except cos and sin,
    and the exponential of the rate times the linear and quadratic terms of the force.
    """
    t, q = b.t1, wave.q
    total = t * (r.one * f.one + t * 0.5 * (r.one * f.t1 + r.t1 * f.one))
    total += t * t * t * ((r.one * f.t2 + r.t1 * f.t1) / 3.0 + t * 0.25 * r.t1 * f.t2)
    line = (r.one + r.t1 * t - r.t1 / q) / q
    parabola = t * (f.t1 + f.t2 * t) - (f.t1 + 2.0 * f.t2 * t - 2.0 * f.t2 / q) / q
    total += b.exp * (f.exp * line + r.exp * parabola / q)
    total += _line_times_free(r.one, r.t1, f.h1, f.h2, b, s, roots)
    if f.res == 0.0:
        return total
    # The term f.res·R is integrated by parts. Let P be the polynomial of the rate, and let G satisfy G′ + q·G = P. With
    # R′ = q·R + S/M (`_resonant_products`), ∫ P·R = G·R − (1/M)·∫ G·S follows.
    gap = roots.r1 - roots.r2
    h1, h2 = (0.0, 1.0) if roots.joined else (1.0 / gap, -1.0 / gap)
    free = _line_times_free(r.one / q - r.t1 / (q * q), r.t1 / q, h1, h2, b, s, roots)
    return total + f.res * (line * b.res - free / wave.mass)


@inlined
def cable_work(
    length_change: Coefficients,
    rate: Coefficients,
    force: Coefficients,
    b: Basis,
    s: float,
    wave: Wave,
    roots: Roots,
) -> float:
    """Return an antiderivative of F_c·L̇ in J at the moment of the basis ``b``, ``s`` seconds after the mode's start.

    Its constant is arbitrary, so only differences within a mode have a meaning. The length must follow from a gait: the
    function does not apply to a length that is given by cubics.

    ``length_change`` and ``rate`` are ΔL and its derivative, ``force`` is F_c.
    """
    steady = force.one * (
        length_change.cos * b.cos + length_change.sin * b.sin + length_change.exp * b.exp
    )
    total = steady + _wave_products(rate, force, b, wave)
    if roots.joined:
        total += _joined_products(rate, force, b, wave, roots)
    else:
        total += _separated_products(rate, force, b, wave, roots)
    if rate.one != 0.0 or rate.t1 != 0.0 or force.t1 != 0.0 or force.t2 != 0.0:
        total += _polynomial_products(rate, force, b, s, wave, roots)
    if force.res != 0.0:
        total += _resonant_products(rate, force, b, wave, roots)
    return total
