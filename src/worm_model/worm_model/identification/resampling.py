# SPDX-License-Identifier: Apache-2.0
"""Bootstrap over runs, for the stages whose cost does not jump (actuation and energy).

Runs get random exponential weights (the Bayesian bootstrap), so that none drops out and a campaign keeps all of its
frequencies. With few runs the spread of such refits is too small by a known factor, and its estimate is
uncertain; both are put right as for the mean of that many normal values.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from worm_model.arrays import Array
from worm_model.identification.estimate import Estimate, quantile

REFITS = 120


def unit_weights(random: np.random.Generator, units: int) -> Array:
    """(REFITS, units) weights of mean 1 in every row."""
    weights = random.exponential(size=(REFITS, units))
    return weights / weights.mean(axis=1, keepdims=True)


def refitted(refit: Callable[[int], Array]) -> Array:
    """(REFITS, k): what every refit gives, in order, computed on all cores."""
    with ThreadPoolExecutor() as pool:
        return np.array(list(pool.map(refit, range(REFITS))))


def spread_factor(units: int) -> float:
    """By what the standard deviation of the refits is to be multiplied for a half-width of 95 %."""
    if units < 2:
        return np.inf
    return float(np.sqrt((units + 1) / (units - 1))) * quantile(units - 1)


def estimates(values: Array, refits: Array, units: int) -> list[Estimate]:
    """An estimate for every entry of ``values`` (k,), from its ``refits`` (REFITS, k)."""
    half = spread_factor(units) * np.maximum(refits.std(axis=0), np.finfo(float).tiny)
    return [
        Estimate(float(v), float(v - h), float(v + h)) for v, h in zip(values, half, strict=True)
    ]


def correlation(refits: Array) -> Array:
    """(k, k) of the refits."""
    deviation = refits.std(axis=0)
    unit = np.where(deviation > 0.0, deviation, np.inf)  # what does not move, moves with nothing
    centred = (refits - refits.mean(axis=0)) / unit
    return np.asarray(centred.T @ centred / refits.shape[0])
