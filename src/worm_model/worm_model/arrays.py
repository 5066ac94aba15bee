# SPDX-License-Identifier: Apache-2.0
"""Types of arrays that most modules use, and the integral of samples."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]  # ns since the epoch


def accumulated(time: Array, value: Array) -> Array:
    """Return the integral (n,) of values (n,) since the first time, by the trapezoidal rule; ``time`` (n,) in s."""
    steps = 0.5 * (value[1:] + value[:-1]) * np.diff(time)
    return np.concatenate([[0.0], np.cumsum(steps)])[: len(value)]
