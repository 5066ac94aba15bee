# SPDX-License-Identifier: Apache-2.0
"""How much better a cause explains what was seen than none does: normal noise, sizes integrated out.

What was seen, y (n,), is taken as N a + x s + noise: N (n, m) are nuisances whose sizes a are standard normal, x the
direction of a cause and s its size, itself standard normal or known to be 1, the noise independent with a variance
each. All integrals have a closed form; a datum that was not seen has the weight 0.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Weighed:
    """Of each cause (h,): natural logarithm of the Bayes factor against none, and the size's mean and deviation."""

    evidence: Array
    size: Array
    deviation: Array


def weigh(
    seen: Array, weight: Array, nuisances: Array, causes: Array, known: NDArray[np.bool_]
) -> Weighed:
    """Weighs causes (h, n) against none; ``weight`` (n,) is one over the variance, ``known`` (h,) where s is 1."""
    weighted = nuisances * weight[:, None]
    inner = np.eye(nuisances.shape[1]) + nuisances.T @ weighted
    cross = causes @ weighted  # (h, m)
    solved = np.linalg.solve(inner, np.column_stack([weighted.T @ seen, cross.T]))
    match = causes @ (weight * seen) - cross @ solved[:, 0]
    power = causes**2 @ weight - np.sum(cross * solved[:, 1:].T, axis=1)
    power = np.maximum(power, 0.0)  # rounding
    free = 0.5 * (match**2 / (1.0 + power) - np.log1p(power))
    return Weighed(
        evidence=np.where(known, match - 0.5 * power, free),
        size=np.where(known, 1.0, match / (1.0 + power)),
        deviation=np.where(known, 0.0, 1.0 / np.sqrt(1.0 + power)),
    )


def weigh_noise(seen: Array, weight: Array, nuisances: Array, others: Array) -> Array:
    """Logarithm of the Bayes factor of noise of other weights, each of ``others`` (h, n), against ``weight`` (n,)."""
    usual = _log_density(seen, weight, nuisances)
    return np.array([_log_density(seen, other, nuisances) - usual for other in others])


def _log_density(seen: Array, weight: Array, nuisances: Array) -> float:
    """Of what was seen, without a cause, but for a constant."""
    weighted = nuisances * weight[:, None]
    inner = np.eye(nuisances.shape[1]) + nuisances.T @ weighted
    match = weighted.T @ seen
    explained = match @ np.linalg.solve(inner, match)
    determinant = np.linalg.slogdet(inner)[1] - np.sum(np.log(weight))
    return float(-0.5 * (seen @ (weight * seen) - explained + determinant))
