# SPDX-License-Identifier: Apache-2.0
"""Stage 3: clearance δ_c and stiffnesses k_eng, k_dis from the fin test (eq:fin_force_piecewise).

The fit is a piecewise linear force with two knees. The sign convention is detected: the stiffer side is the engaging
side. If the force decreases with the displacement, the test has recorded the fin's reaction, and the force is negated.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import OptimizeResult, least_squares

from worm_model.arrays import Array
from worm_model.errors import IdentificationError
from worm_model.identification.fits.estimate import (
    SIGMA_PER_MAD,
    Estimate,
    dependence,
    follow_profile,
    if_identifiable,
    quantile,
)

COLUMNS = ("displacement_m", "force_N")
KEYS = ("clearance", "engaged_stiffness", "disengaged_stiffness")
FEWEST_POINTS = 12
TOO_VAGUE = "its interval from the fin test exceeds half its value on either side; repeat the test with more points"
ANISOTROPY = 1.15  # smallest ratio of the stiffnesses that determines the engaging side
# The centre of the clearance differs significantly from zero if it exceeds this number of its standard deviations.
SIGNIFICANT = 3.0


@dataclass(frozen=True)
class FinFit:
    """Result of the fin test.

    Attributes:
        clearance, engaged_stiffness, disengaged_stiffness: estimates, m, N/m, N/m.
        covariance: covariance of the three estimates, shape (3, 3).
        centre: centre of the clearance in the test's coordinate, m.
        engages: sign of the displacement that engages, −1 or +1.
        displacement, force: finite samples, m and N, shape (n,); the force is negated if it was recorded as reaction.
    """

    clearance: Estimate
    engaged_stiffness: Estimate
    disengaged_stiffness: Estimate
    covariance: Array
    centre: float
    engages: int
    displacement: Array
    force: Array

    @property
    def values(self) -> Array:
        """Clearance, engaged and disengaged stiffness, shape (3,)."""
        return np.array([getattr(self, key).value for key in KEYS])

    def force_at(self, displacement: Array) -> Array:
        """Return the fitted force (N) at displacements in metres, shape (k,)."""
        low, high = self.engaged_stiffness.value, self.disengaged_stiffness.value
        if self.engages > 0:
            low, high = high, low
        return _force(np.array([self.clearance.value, low, high, self.centre]), displacement)


def _force(values: Array, x: Array) -> Array:
    """Return the force (N) at displacements ``x`` (m) for (clearance, stiffness below, stiffness above, centre).

    The stiffness below acts at displacements below the clearance, the stiffness above at those above it.
    """
    clearance, below, above, centre = values
    deflection = x - centre
    return below * np.minimum(deflection + 0.5 * clearance, 0.0) + above * np.maximum(
        deflection - 0.5 * clearance, 0.0
    )


def fit_fin(displacement: Array, force: Array) -> FinFit:
    """Fit the piecewise linear force by robust least squares.

    As in the paper, the centre of the clearance is the zero of the test. It is fitted only if it differs significantly
    from zero (`SIGNIFICANT`).

    Args:
        displacement: m, shape (n,).
        force: N, shape (n,).
    """
    known = np.isfinite(displacement) & np.isfinite(force)
    x, y = displacement[known], force[known]
    if x.size < FEWEST_POINTS or x.min() >= 0.0 or x.max() <= 0.0:
        raise IdentificationError(
            f"fin test: {x.size} usable points; at least {FEWEST_POINTS} are needed, on both sides of 0"
        )
    reaction = bool(np.polyfit(x, y, 1)[0] < 0.0)
    line = _BrokenLine(x, -y if reaction else y)
    free = [0, 1, 2, 3]
    values, covariance = line.fit(line.start(), free)
    if abs(values[3]) <= SIGNIFICANT * np.sqrt(covariance[3, 3]):
        free = [0, 1, 2]
        values, covariance = line.fit(np.array([*values[:3], 0.0]), free)
    side = _engaging_side(values)
    order = [0, 1, 2] if side < 0 else [0, 2, 1]
    clearance, engaged, disengaged = (line.interval(values, covariance, k, free) for k in order)
    return FinFit(
        clearance=clearance,
        engaged_stiffness=engaged,
        disengaged_stiffness=disengaged,
        covariance=covariance[np.ix_(order, order)],
        centre=float(values[3]),
        engages=side,
        displacement=x,
        force=line.y,
    )


def _engaging_side(values: Array) -> int:
    _, below, above, _ = values
    if min(below, above) <= 0.0:
        raise IdentificationError("fin test: no force beyond the clearance on one of its sides")
    if max(below / above, above / below) < ANISOTROPY:
        raise IdentificationError(
            f"fin test: {below:.0f} N/m below 0 and {above:.0f} N/m above do not show which side engages; repeat it "
            "farther beyond the clearance"
        )
    return -1 if below > above else 1


class _BrokenLine:
    """Robust fit of (clearance, stiffness below, stiffness above, centre) to a test.

    ``worth`` is the factor on the variance for correlated residuals (`dependence`). ``noise`` is the robust standard
    deviation of the force, N.
    """

    def __init__(self, x: Array, y: Array) -> None:
        self.x, self.y = x, y
        start = self.start()
        self.worth = dependence(y - _force(start, x))
        self.noise = max(SIGMA_PER_MAD * float(np.median(np.abs(y - _force(start, x)))), 1e-9)

    def start(self) -> Array:
        """Return the start values of a fit, shape (4,).

        They are the best ones for a grid of clearances, because the cost has several local minima.
        """
        x, y = self.x, self.y
        tried = []
        for clearance in np.linspace(0.02, 1.9, 48) * min(-x.min(), x.max()):
            low = np.minimum(x + 0.5 * clearance, 0.0)
            high = np.maximum(x - 0.5 * clearance, 0.0)
            slopes, *_ = np.linalg.lstsq(np.stack([low, high], axis=1), y, rcond=None)
            values = np.array([clearance, *slopes, 0.0])
            tried.append((float(np.sum(np.abs(y - _force(values, x)))), values))
        return min(tried, key=lambda pair: pair[0])[1]

    def fit(self, start: Array, free: list[int]) -> tuple[Array, Array]:
        """Return values (4,) and covariance (4, 4) of a fit of the entries with the indices ``free``.

        The other entries keep their values in ``start`` and have zero covariance.
        """
        index = np.array(free)
        result = self._solve(start, index)
        values = start.copy()
        values[index] = result.x
        freedom = max(self.x.size - index.size, 1)
        variance = 2.0 * result.cost / freedom * self.worth
        covariance = np.zeros((4, 4))
        covariance[np.ix_(index, index)] = np.linalg.pinv(result.jac.T @ result.jac) * variance
        return values, covariance

    def interval(self, values: Array, covariance: Array, entry: int, free: list[int]) -> Estimate:
        """Return the estimate of one of the ``free`` entries, with the 95 % interval from the profile of the cost."""
        others = np.array([k for k in free if k != entry])
        freedom = max(self.x.size - len(free), 1)
        best = self._solve(values, others)
        tail = quantile(freedom / self.worth)
        rise = 2.0 * best.cost / freedom * self.worth * tail**2

        def cost(value: float) -> float:
            start = values.copy()
            start[entry] = value
            return 2.0 * float(self._solve(start, others).cost - best.cost)

        reach = tail * float(np.sqrt(covariance[entry, entry]))
        value = float(values[entry])
        low, high = (follow_profile(cost, value, rise, sign * reach) for sign in (-1.0, 1.0))
        return if_identifiable(Estimate(value, low, high), note=TOO_VAGUE)

    def _solve(self, start: Array, index: NDArray[np.intp]) -> OptimizeResult:
        def residuals(free: Array) -> Array:
            values = start.copy()
            values[index] = free
            return (_force(values, self.x) - self.y) / self.noise

        scale = np.array([1e-3, 100.0, 100.0, 1e-3])[index]
        return least_squares(residuals, start[index], x_scale=scale, loss="huber", f_scale=3.0)
