# SPDX-License-Identifier: Apache-2.0
"""What the stages share: robust scales, weights of samples, and least squares with nuisances of each run."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from worm_model.arrays import Array

SIGMA_PER_MAD = 1.4826  # of a normal distribution
OUTLIER = 5.0  # scales
MOST_MEMORY = 0.9
ONE_SIDED = 1.645  # standard deviations of a correlation that white residuals exceed once in twenty


def scale_of(values: ArrayLike) -> float:
    """Robust standard deviation (median absolute deviation) of the finite values; 0 without any."""
    array = np.asarray(values, dtype=float)
    finite = array[np.isfinite(array)]
    if not finite.size:
        return 0.0
    return float(SIGMA_PER_MAD * np.median(np.abs(finite - np.median(finite))))


def noise_of(values: ArrayLike) -> float:
    """Standard deviation of white noise on a smooth signal, from second differences; the noise of `scale_of`."""
    return scale_of(np.diff(np.asarray(values, dtype=float), 2)) / np.sqrt(6.0)


def dependence(residuals: Array) -> float:
    """By what the variance of a fit is to be multiplied for residuals that resemble the one before them, at least 1.

    A bench test has hysteresis, and its residuals (n,), in the order in which they were taken, then say less than as
    many independent ones. As for a first-order autoregression; 1 where the correlation could be chance.
    """
    r = residuals / max(scale_of(residuals), 1e-300)
    r = np.clip(r - np.median(r), -OUTLIER, OUTLIER)
    count = r.size
    correlation = float(np.sum(r[1:] * r[:-1]) / max(float(np.sum(r * r)), 1e-300))
    if correlation < ONE_SIDED / np.sqrt(count):
        return 1.0
    # The estimate around a fitted line is too small by about (2 + 4ρ)/n (Kendall 1954).
    memory = min(correlation + (2.0 + 4.0 * correlation) / count, MOST_MEMORY)
    return (1.0 + memory) / (1.0 - memory)
