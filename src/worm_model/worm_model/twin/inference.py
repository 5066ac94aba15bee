# SPDX-License-Identifier: Apache-2.0
"""Bayes factors of causes against the null hypothesis, for normal noise, with the sizes integrated out.

The data y (k, b) of k cycles with b values each are modelled as N a + c u + x s + noise:

- N (k, b, m) contains the nuisance directions. Their sizes a (m,) are standard normal.
- c (b,) contains the standard deviations of offsets that are the same in all cycles. Their sizes u (b,) are standard
  normal, and c u is the product by element.
- x (k, b) is the direction of a cause. The size s of the cause is standard normal, or known to be 1.
- The noise is independent, with one variance for each value. A missing value has the weight (inverse variance) 0.

All integrals have a closed form (Woodbury's identity, and the Sherman–Morrison identity for the offsets).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from worm_model.arrays import Array


@dataclass(frozen=True)
class Weighed:
    """Result for each cause (h,).

    Attributes:
        evidence: natural logarithm of the Bayes factor against the null hypothesis.
        size: posterior mean of the size.
        deviation: posterior standard deviation of the size.
    """

    evidence: Array
    size: Array
    deviation: Array


class NullModel:
    """Null hypothesis: normal noise and nuisances without any cause.

    Args:
        measured: data y, shape (k, b).
        weight: inverse variances of the noise, shape (k, b); for `log_densities` also (h, k, b), of h noises.
        nuisances: nuisance directions, shape (k, b, m).
        offsets: standard deviations c of the offsets that are the same in all cycles, shape (b,).
    """

    def __init__(self, measured: Array, weight: Array, nuisances: Array, offsets: Array) -> None:
        self._measured, self._weight = measured, weight
        # factor by which the offsets increase the determinant of the covariance
        self._growth = 1.0 + offsets**2 * weight.sum(axis=-2)  # (..., b)
        self._shared = offsets**2 / self._growth
        directions = nuisances.reshape(measured.size, -1)
        weighted = self._weigh(np.moveaxis(nuisances, -1, 0))
        self._weighted = weighted.reshape(*weighted.shape[:-2], measured.size)  # (..., m, n)
        self._inner = np.eye(directions.shape[1]) + self._weighted @ directions
        self._match = self._weighted @ measured.ravel()

    def _weigh(self, vectors: Array) -> Array:
        """Return vectors (m, k, b) multiplied by the inverse covariance of noise and offsets, shape (..., m, k, b)."""
        weight = self._weight[..., None, :, :]
        weighted = weight * vectors
        common = self._shared[..., None, :] * weighted.sum(axis=-2)
        return np.asarray(weighted - weight * common[..., None, :])

    def weigh(self, causes: Array, known: NDArray[np.bool_]) -> Weighed:
        """Return the evidence for causes (h, k, b); ``known`` (h,) is True where the size is known to be 1."""
        flat = causes.reshape(len(causes), -1)
        cross = flat @ self._weighted.T  # (h, m)
        solved = np.linalg.solve(self._inner, np.column_stack([self._match, cross.T]))
        match = flat @ self._weigh(self._measured[None]).ravel() - cross @ solved[:, 0]
        weighted = self._weight * causes
        alone = np.einsum("hkb,hkb->h", weighted, causes)
        alone -= weighted.sum(axis=1) ** 2 @ self._shared
        power = alone - np.sum(cross * solved[:, 1:].T, axis=1)
        power = np.maximum(power, 0.0)  # negative only by rounding
        free = 0.5 * (match**2 / (1.0 + power) - np.log1p(power))
        return Weighed(
            evidence=np.where(known, match - 0.5 * power, free),
            size=np.where(known, 1.0, match / (1.0 + power)),
            deviation=np.where(known, 0.0, 1.0 / np.sqrt(1.0 + power)),
        )

    def log_densities(self) -> Array:
        """Return the logarithm of the data's marginal density for each noise, except for a common constant.

        The shape is (h,), or () of one noise.
        """
        solved = np.linalg.solve(self._inner, self._match[..., None])[..., 0]
        own = self._weigh(self._measured[None])[..., 0, :, :]
        distance = (self._measured * own).sum(axis=(-2, -1)) - (self._match * solved).sum(axis=-1)
        noise = np.log(self._weight, out=np.zeros_like(self._weight), where=self._weight > 0.0)
        spread = np.linalg.slogdet(self._inner)[1] + np.log(self._growth).sum(axis=-1)
        return np.asarray(-0.5 * (distance + spread - noise.sum(axis=(-2, -1))))
