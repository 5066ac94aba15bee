# SPDX-License-Identifier: Apache-2.0
"""Stage 3: clearance δ_c and stiffnesses k_eng, k_dis from the fin test (eq:fin_force_piecewise).

A broken line with two knees is fitted. The sign convention is found out: the stiffer side is the engaging one,
whichever sign the test gave it, and a force that is counted as reaction is turned round.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import OptimizeResult, least_squares

from worm_model.arrays import Array
from worm_model.identification.estimate import Estimate, follow_profile, if_told, quantile
from worm_model.identification.identification_errors import IdentificationError
from worm_model.identification.robust import SIGMA_PER_MAD, dependence

COLUMNS = ("displacement_m", "force_N")
KEYS = ("clearance", "engaged_stiffness", "disengaged_stiffness")
FEWEST_POINTS = 12
TOO_VAGUE = "the fin test leaves it open by more than half its value; repeat it with more points"
ANISOTROPY = 1.15  # between the stiffnesses, below which a test does not tell which side engages
SIGNIFICANT = 3.0  # standard deviations from which the test stand's zero counts as off


@dataclass(frozen=True)
class FinFit:
    """``clearance`` m, ``engaged_stiffness`` and ``disengaged_stiffness`` N/m.

    ``covariance`` (3, 3) of the three in this order; ``centre`` m, where the test's zero lies from the middle of
    the clearance; ``engages`` −1 or +1, the sign of displacement that engages; ``displacement``, ``force`` (n,) the
    test's samples, the force turned where it was counted against the displacement.
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
        """(clearance, engaged, disengaged stiffness)."""
        return np.array([getattr(self, key).value for key in KEYS])

    def force_at(self, displacement: Array) -> Array:
        """The fitted force in N at displacements (m,) in m."""
        low, high = self.engaged_stiffness.value, self.disengaged_stiffness.value
        if self.engages > 0:
            low, high = high, low
        return _force(np.array([self.clearance.value, low, high, self.centre]), displacement)


def _force(values: Array, x: Array) -> Array:
    """Force of (clearance, stiffness below, stiffness above, centre)."""
    clearance, below, above, centre = values
    deflection = x - centre
    return below * np.minimum(deflection + 0.5 * clearance, 0.0) + above * np.maximum(
        deflection - 0.5 * clearance, 0.0
    )


def fit_fin(displacement: Array, force: Array, engages: int = 0) -> FinFit:
    """The broken line with the least robust squares; ``engages`` −1 or +1 states the engaging sign, 0 finds it.

    ``displacement`` m and ``force`` N, (n,) each. The clearance lies around the test's zero, as in the paper, unless
    that zero is plainly off. Raises `IdentificationError` if the test does not show two stiffnesses, or not which
    of them engages.
    """
    known = np.isfinite(displacement) & np.isfinite(force)
    x, y = displacement[known], force[known]
    if x.size < FEWEST_POINTS or x.min() >= 0.0 or x.max() <= 0.0:
        raise IdentificationError(
            f"fin test: {x.size} usable points; {FEWEST_POINTS} are needed, on both sides of 0"
        )
    reaction = bool(np.polyfit(x, y, 1)[0] < 0.0)
    line = _BrokenLine(x, -y if reaction else y)
    values, covariance = line.fit(line.start(), [True, True, True, True])
    if abs(values[3]) <= SIGNIFICANT * np.sqrt(covariance[3, 3]):
        values, covariance = line.fit(np.array([*values[:3], 0.0]), [True, True, True, False])
    side = engages or _engaging_side(values)
    order = [0, 1, 2] if side < 0 else [0, 2, 1]
    clearance, engaged, disengaged = (line.interval(values, covariance, k) for k in order)
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
            f"fin test: {below:.0f} N/m below 0 and {above:.0f} N/m above: which side engages cannot be told; "
            "say so with --fin-engages"
        )
    return -1 if below > above else 1


class _BrokenLine:
    """Robust fits of (clearance, stiffness below, stiffness above, centre) to a test."""

    def __init__(self, x: Array, y: Array) -> None:
        self.x, self.y = x, y
        start = self.start()
        self.worth = dependence(y - _force(start, x))
        self.noise = max(SIGMA_PER_MAD * float(np.median(np.abs(y - _force(start, x)))), 1e-9)

    def start(self) -> Array:
        """The best of a grid of clearances: the knees' cost has several valleys."""
        x, y = self.x, self.y
        tried = []
        for clearance in np.linspace(0.02, 1.9, 48) * min(-x.min(), x.max()):
            low = np.minimum(x + 0.5 * clearance, 0.0)
            high = np.maximum(x - 0.5 * clearance, 0.0)
            slopes, *_ = np.linalg.lstsq(np.stack([low, high], axis=1), y, rcond=None)
            values = np.array([clearance, *slopes, 0.0])
            tried.append((float(np.sum(np.abs(y - _force(values, x)))), values))
        return min(tried, key=lambda pair: pair[0])[1]

    def fit(self, start: Array, free: list[bool]) -> tuple[Array, Array]:
        """(values (4,), covariance (4, 4)) with some entries free, the others as in the start."""
        index = np.flatnonzero(free)
        result = self._solve(start, index)
        values = start.copy()
        values[index] = result.x
        freedom = max(self.x.size - index.size, 1)
        variance = 2.0 * result.cost / freedom * self.worth
        covariance = np.zeros((4, 4))
        covariance[np.ix_(index, index)] = np.linalg.pinv(result.jac.T @ result.jac) * variance
        return values, covariance

    def interval(self, values: Array, covariance: Array, entry: int) -> Estimate:
        """An entry's 95 % interval: where the cost, the other entries refitted, has risen enough."""
        free = [k for k in range(4) if k != entry and covariance[k, k] > 0.0]
        freedom = max(self.x.size - len(free) - 1, 1)
        best = self._solve(values, np.array(free))
        tail = quantile(freedom / self.worth)
        rise = 2.0 * best.cost / freedom * self.worth * tail**2

        def cost(value: float) -> float:
            start = values.copy()
            start[entry] = value
            return 2.0 * float(self._solve(start, np.array(free)).cost - best.cost)

        reach = tail * float(np.sqrt(covariance[entry, entry]))
        value = float(values[entry])
        low, high = (follow_profile(cost, value, rise, sign * reach) for sign in (-1.0, 1.0))
        return if_told(Estimate(value, low, high), note=TOO_VAGUE)

    def _solve(self, start: Array, index: NDArray[np.intp]) -> OptimizeResult:
        def residuals(free: Array) -> Array:
            values = start.copy()
            values[index] = free
            return (_force(values, self.x) - self.y) / self.noise

        scale = np.array([1e-3, 100.0, 100.0, 1e-3])[index]
        return least_squares(residuals, start[index], x_scale=scale, loss="huber", f_scale=3.0)
