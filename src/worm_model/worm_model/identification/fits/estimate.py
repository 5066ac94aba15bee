# SPDX-License-Identifier: Apache-2.0
"""Estimates with 95 % intervals, profile likelihood, and robust statistics of residuals."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from worm_model.arrays import Array
from worm_msgs.robot_parameters import ROWS

CONFIDENCE = 0.95
MOST_STEPS = 12  # largest number of evaluations of a profile
# The search in a profile ends when its bracket is narrower than this, relative to the outer end of the bracket. A
# discontinuous cost may never equal the required rise.
NARROW = 0.03
VAGUE = 0.5  # largest half-width of a useful interval, relative to the value
LEFT_OPEN = "its interval is wider than half its value on either side; add longer runs or runs with other gaits"


@dataclass(frozen=True)
class Estimate:
    """Estimated ``value`` with 95 % bounds ``low`` and ``high`` in the parameter's unit.

    If the data do not determine the parameter, ``identifiable`` is False and the bounds are NaN. The value is then
    given, depends on given values, or is only the best fit. ``note`` states which of these applies, and why.
    """

    value: float
    low: float
    high: float
    identifiable: bool = True
    note: str = ""

    def as_dict(self) -> dict[str, Any]:
        """Return the entry for machine-readable output, with the note if it is not empty."""
        return {name: value for name, value in asdict(self).items() if name != "note" or value}

    @property
    def spread(self) -> float:
        """Half the width of the interval."""
        return 0.5 * (self.high - self.low)


def quantile(degrees: float) -> float:
    """Return the half-width of a 95 % interval in standard deviations, by Student's t distribution.

    ``degrees`` are the degrees of freedom, infinite for a normal distribution. Values below 1 count as 1.
    """
    from scipy.special import stdtrit  # here: SciPy loads slowly, also for --help of `health`

    return float(stdtrit(max(degrees, 1.0), 0.5 + 0.5 * CONFIDENCE))


def half_of_mean(values: Array) -> float:
    """Return the half-width of the 95 % interval of the mean of at least two values (n,)."""
    return quantile(values.size - 1) * float(values.std(ddof=1) / np.sqrt(values.size))


def not_identifiable(value: float, note: str) -> Estimate:
    """Return an estimate without bounds; ``note`` states why."""
    return Estimate(value, float("nan"), float("nan"), False, note)


def admissible(key: str, estimate: Estimate) -> Estimate:
    """Return the estimate of a parameter with its interval cut to the parameter's admissible range."""
    low, high = np.clip((estimate.low, estimate.high), ROWS[key]["low"], ROWS[key]["high"])
    return replace(estimate, low=float(low), high=float(high))


def if_identifiable(estimate: Estimate, usual: float = 0.0, note: str = "") -> Estimate:
    """Return the estimate, marked as not identifiable if its interval is open or too wide.

    An interval is too wide if its half-width exceeds half the value, or half the ``usual`` value if that is larger: a
    slack of 0 ± 0.1 mm is identifiable. ``note`` is the reason for an open interval, if it is known.
    """
    # The comparison is False if the spread is infinite or NaN.
    if estimate.spread <= VAGUE * max(abs(estimate.value), usual) or not estimate.identifiable:
        return estimate
    return not_identifiable(estimate.value, note or LEFT_OPEN)


def follow_profile(
    cost: Callable[[float], float],
    best: float,
    rise: float,
    guess: float,
    reach: float = np.inf,
) -> float:
    """Return the position on one side of ``best`` at which a profile exceeds its minimum by ``rise``.

    A profile is the lowest cost as a function of one parameter. Each step of the search assumes a parabola.

    Args:
        cost: cost above the minimum as a function of the parameter.
        best: position of the minimum.
        rise: required rise of the cost.
        guess: first offset from ``best``; its sign selects the side.
        reach: largest offset to evaluate.

    Returns:
        The position; infinite if the cost rises by less within ``reach``. If the cost jumps over ``rise``, a position
        just beyond the jump. With data without noise, ``rise`` is 0 and the position is ``best``.
    """
    if rise == 0.0:
        return best
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
