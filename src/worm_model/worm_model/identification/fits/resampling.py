# SPDX-License-Identifier: Apache-2.0
"""Bootstrap over runs, for the stages with a continuous cost (actuation and energy).

Runs get random exponential weights (Bayesian bootstrap), so that every refit contains all frequencies. With few runs,
the spread of the refits is too small by a known factor, and the spread itself is uncertain. Both effects are corrected
as for the mean of an equal number of normally distributed values.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from worm_model.arrays import Array
from worm_model.identification.fits.estimate import Estimate, quantile

REFITS = 120  # number of refits of a bootstrap
SEED = 0  # of a bootstrap, so that equal data result in equal intervals


def unit_weights(random: np.random.Generator, units: int) -> Array:
    """Return random weights with mean 1 in every row, shape (REFITS, units)."""
    weights = random.exponential(size=(REFITS, units))
    return weights / weights.mean(axis=1, keepdims=True)


def spread_factor(units: int) -> float:
    """Return the ratio of a 95 % half-width to the standard deviation of the refits.

    ``units`` is the number of runs or cycles that the bootstrap draws.
    """
    if units < 2:
        return np.inf
    return float(np.sqrt((units + 1) / (units - 1))) * quantile(units - 1)


def estimates(values: Array, refits: Array, units: int | Sequence[int]) -> list[Estimate]:
    """Return an estimate for each entry of ``values`` (k,) from its ``refits`` (REFITS, k).

    ``units`` is the number of runs or cycles with information about each entry; a single number applies to all entries.
    """
    factors = [spread_factor(number) for number in np.broadcast_to(units, values.shape)]
    half = factors * np.maximum(refits.std(axis=0), np.finfo(float).tiny)
    return [
        Estimate(float(v), float(v - h), float(v + h)) for v, h in zip(values, half, strict=True)
    ]


def correlation(refits: Array) -> Array:
    """Return the correlation matrix (k, k) of the refits."""
    deviation = refits.std(axis=0)
    unit = np.where(deviation > 0.0, deviation, np.inf)  # constant entries have zero correlation
    centred = (refits - refits.mean(axis=0)) / unit
    return np.asarray(centred.T @ centred / refits.shape[0])
