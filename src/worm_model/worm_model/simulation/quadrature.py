# SPDX-License-Identifier: Apache-2.0
"""Integrals of sampled quantities."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def accumulated(time: Array, value: Array) -> Array:
    """Return the integral (n,) of values (n,) since the first time, by the trapezoidal rule; ``time`` (n,) in s."""
    steps = 0.5 * (value[1:] + value[:-1]) * np.diff(time)
    return np.concatenate([[0.0], np.cumsum(steps)])[: len(value)]
