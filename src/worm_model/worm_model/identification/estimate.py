# SPDX-License-Identifier: Apache-2.0
"""An estimate with its 95 % interval, and how one is made of a cost that was followed to both sides."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy.stats import t as student

from worm_model.arrays import Array

CONFIDENCE = 0.95
MOST_STEPS = 12  # by which a profile looks for its end
NARROW = 0.03  # of an end's distance, between whose bounds it is found: where a cost jumps it meets no value
VAGUE = 0.5  # half-width relative to the value from which a number would pretend
LEFT_OPEN = (
    "the data leave it open by more than half its value; add runs that go further or at other gaits"
)


@dataclass(frozen=True)
class Estimate:
    """``value`` and 95 % bounds ``low``, ``high`` in the parameter's unit.

    What the data cannot tell is not ``identifiable``: then the bounds are NaN, the value is one that was given or
    that goes with what was given or with nearly anything else, and ``note`` says which and why.
    """

    value: float
    low: float
    high: float
    identifiable: bool = True
    note: str = ""

    def as_dict(self) -> dict[str, Any]:
        """As the machine-readable output has it; with the note if there is one."""
        return {name: value for name, value in asdict(self).items() if name != "note" or value}

    @property
    def spread(self) -> float:
        """Half the width of the interval."""
        return 0.5 * (self.high - self.low)


def quantile(degrees: float) -> float:
    """How many standard deviations 95 % intervals reach to each side, for so many degrees of freedom."""
    return float(student.ppf(0.5 + 0.5 * CONFIDENCE, max(degrees, 1.0)))


def half_of_mean(values: Array) -> float:
    """By how much the 95 % interval of the mean of some values (n,), two at least, reaches to each side."""
    return quantile(values.size - 1) * float(values.std(ddof=1) / np.sqrt(values.size))


def not_told(value: float, note: str) -> Estimate:
    """A value without bounds, and why."""
    return Estimate(value, float("nan"), float("nan"), False, note)


def if_told(estimate: Estimate, usual: float = 0.0, note: str = LEFT_OPEN) -> Estimate:
    """The estimate, or one that is not identifiable where its interval is open or too wide to mean anything.

    Too wide is more than half of the value, or of what is ``usual`` if that is more: a slack of 0 ± 0.1 mm is told.
    """
    narrow = estimate.spread <= VAGUE * max(
        abs(estimate.value), usual
    )  # False if it is infinite or NaN
    return estimate if narrow or not estimate.identifiable else not_told(estimate.value, note)


def follow_profile(
    cost: Callable[[float], float],
    best: float,
    rise: float,
    guess: float,
    reach: float = np.inf,
) -> float:
    """Where a profile has risen by ``rise`` above its minimum at ``best``, on the side of ``guess`` (an offset).

    ``cost`` is the cost above the minimum, no farther than ``reach`` from ``best``. The profile is taken for a
    parabola from one step to the next. Infinite if it never rises that far; where it jumps, the far side of the jump.
    """
    offset, low, high = min(abs(guess), reach), 0.0, np.inf
    for _ in range(MOST_STEPS):
        risen = cost(best + float(np.copysign(offset, guess)))
        if abs(risen - rise) < 0.05 * rise:
            return best + float(np.copysign(offset, guess))
        low, high = (offset, high) if risen < rise else (low, offset)
        if low >= reach or high - low < NARROW * high:
            break
        factor = float(np.sqrt(rise / max(risen, 0.1 * rise)))
        offset = min(offset * min(max(factor, 0.3), 3.0), reach)
        if not low < offset < high:
            offset = 0.5 * (low + min(high, reach))
    return best + float(np.copysign(high, guess))
