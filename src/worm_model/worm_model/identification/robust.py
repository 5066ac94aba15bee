# SPDX-License-Identifier: Apache-2.0
"""What the stages share: robust scales, weights of samples, and least squares with nuisances of each run."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

SIGMA_PER_MAD = 1.4826  # of a normal distribution
OUTLIER = 5.0  # scales


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
