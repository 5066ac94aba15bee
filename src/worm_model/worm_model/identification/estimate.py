# SPDX-License-Identifier: Apache-2.0
"""An estimate with its 95 % interval, and how one is made of a cost that was followed to both sides."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

Array = NDArray[np.float64]

CONFIDENCE = 0.95
MOST_STEPS = 12  # by which a profile looks for its end


@dataclass(frozen=True)
class Estimate:
    """``value`` and 95 % bounds ``low``, ``high`` in the parameter's unit.

    What the data cannot tell is not ``identifiable``: then the value is one that was given, and ``note`` says why.
    """

    value: float
    low: float
    high: float
    identifiable: bool = True
    note: str = ""

    @property
    def spread(self) -> float:
        """Half the width of the interval."""
        return 0.5 * (self.high - self.low)


def quantile(degrees: float) -> float:
    """How many standard deviations 95 % intervals reach to each side, for so many degrees of freedom."""
    return float(student.ppf(0.5 + 0.5 * CONFIDENCE, max(degrees, 1.0)))


def follow_profile(cost: Callable[[float], float], best: float, rise: float, guess: float) -> float:
    """Where a profile has risen by ``rise`` above its minimum at ``best``, on the side of ``guess`` (an offset).

    ``cost`` is the cost above the minimum. The profile is taken for a parabola from one step to the next.
    """
    offset, low, high = guess, 0.0, np.inf
    for _ in range(MOST_STEPS):
        risen = cost(best + offset)
        if abs(risen - rise) < 0.05 * rise:
            break
        low, high = (abs(offset), high) if risen < rise else (low, abs(offset))
        factor = float(np.sqrt(rise / max(risen, 0.1 * rise)))
        size = abs(offset) * min(max(factor, 0.3), 3.0)
        if not low < size < high:
            size = 0.5 * (low + high)
        offset = float(np.copysign(size, guess))
    return best + offset
