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


class Sound:
    """What none of the causes explains: normal noise and the nuisances.

    Args:
        seen: (n,).
        weight: (n,), one over the variance of its noise.
        nuisances: (n, m).
    """

    def __init__(self, seen: Array, weight: Array, nuisances: Array) -> None:
        self._seen, self._weight, self._nuisances = seen, weight, nuisances
        self._weighted = nuisances * weight[:, None]
        self._inner = np.eye(nuisances.shape[1]) + nuisances.T @ self._weighted
        self._match = self._weighted.T @ seen

    def weigh(self, causes: Array, known: NDArray[np.bool_]) -> Weighed:
        """Weighs causes (h, n) against none; ``known`` (h,) where s is 1."""
        cross = causes @ self._weighted  # (h, m)
        solved = np.linalg.solve(self._inner, np.column_stack([self._match, cross.T]))
        match = causes @ (self._weight * self._seen) - cross @ solved[:, 0]
        power = causes**2 @ self._weight - np.sum(cross * solved[:, 1:].T, axis=1)
        power = np.maximum(power, 0.0)  # rounding
        free = 0.5 * (match**2 / (1.0 + power) - np.log1p(power))
        return Weighed(
            evidence=np.where(known, match - 0.5 * power, free),
            size=np.where(known, 1.0, match / (1.0 + power)),
            deviation=np.where(known, 0.0, 1.0 / np.sqrt(1.0 + power)),
        )

    def weigh_noise(self, others: Array) -> Array:
        """Logarithm of the Bayes factor of noise of other weights, each of ``others`` (h, n), against its own."""
        inner, match, of_noise = [self._inner], [self._match], [0.0]
        for other in others:
            rows = other != self._weight  # few
            seen, nuisances = self._seen[rows], self._nuisances[rows]
            change = (other - self._weight)[rows]
            inner.append(self._inner + nuisances.T @ (nuisances * change[:, None]))
            match.append(self._match + nuisances.T @ (change * seen))
            of_noise.append(np.sum(np.log(other[rows] / self._weight[rows]) - change * seen**2))
        matches = np.array(match)
        explained = np.linalg.solve(np.array(inner), matches[..., None])[..., 0]
        spread = np.linalg.slogdet(np.array(inner))[1]
        density = 0.5 * (np.sum(matches * explained, axis=1) - spread + np.array(of_noise))
        factors: Array = density[1:] - density[0]
        return factors
