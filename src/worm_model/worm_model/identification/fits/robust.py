# SPDX-License-Identifier: Apache-2.0
"""Robust statistics of the stages: scales, noise and correlation of residuals."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from worm_model.arrays import Array

# Ratio of the standard deviation to the median absolute deviation of a normal distribution
SIGMA_PER_MAD = 1.4826
OUTLIER = 5.0  # residual of an outlier, in robust standard deviations
MOST_MEMORY = 0.9  # largest correlation of successive residuals; at 1 `dependence` is infinite
ONE_SIDED = 1.645  # one-sided 95 % quantile of the normal distribution


def scale_of(values: ArrayLike) -> float:
    """Return the robust standard deviation (from the median absolute deviation) of the finite values; 0 if none."""
    array = np.asarray(values, dtype=float)
    finite = array[np.isfinite(array)]
    if not finite.size:
        return 0.0
    return float(SIGMA_PER_MAD * np.median(np.abs(finite - np.median(finite))))


def noise_of(values: ArrayLike) -> float:
    """Return the standard deviation of white noise on a smooth signal, from second differences."""
    return scale_of(np.diff(np.asarray(values, dtype=float), 2)) / np.sqrt(6.0)


def dependence(residuals: Array) -> float:
    """Return the factor on the variance of a fit for correlated residuals, at least 1.

    Because of hysteresis, the residuals (n,) of a bench test, in the order of measurement, are correlated and contain
    less information. The factor follows from a first-order autoregression; it is 1 without significant correlation.
    """
    r = residuals / max(scale_of(residuals), 1e-300)
    r = np.clip(r - np.median(r), -OUTLIER, OUTLIER)
    count = r.size
    correlation = float(np.sum(r[1:] * r[:-1]) / max(float(np.sum(r * r)), 1e-300))
    if correlation < ONE_SIDED / np.sqrt(count):
        return 1.0
    # The correlation ρ of residuals of a fitted line is too small by about (2 + 4ρ)/n (Kendall 1954).
    memory = min(correlation + (2.0 + 4.0 * correlation) / count, MOST_MEMORY)
    return (1.0 + memory) / (1.0 - memory)
