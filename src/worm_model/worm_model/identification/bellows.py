# SPDX-License-Identifier: Apache-2.0
"""Stage 2: bellows stiffness k_b from a force–deformation test."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from worm_model.arrays import Array
from worm_model.errors import IdentificationError
from worm_model.identification.fits.estimate import (
    OUTLIER,
    Estimate,
    dependence,
    quantile,
    scale_of,
)

COLUMNS = ("compression_m", "force_N")
FEWEST_POINTS = 5  # smallest number of points of a test


@dataclass(frozen=True)
class BellowsFit:
    """Straight line through the bellows test.

    Attributes:
        stiffness: estimate, N/m.
        offset: force at zero compression (the load cell's zero), N.
        compression, force: finite samples of the test, including outliers, m and N, shape (n,).
    """

    stiffness: Estimate
    offset: float
    compression: Array
    force: Array


def fit_bellows(compression: Array, force: Array) -> BellowsFit:
    """Fit a straight line by least squares; outliers are excluded.

    The interval follows from Student's t distribution and is exact for white noise. If the residuals are correlated
    (hysteresis), the interval is computed for a smaller number of independent points. The scale factor of the load
    cell is assumed to be correct.

    Args:
        compression: m, shape (n,), in the order of measurement.
        force: N, shape (n,).
    """
    known = np.isfinite(compression) & np.isfinite(force)
    x, y = compression[known], force[known]
    if x.size < FEWEST_POINTS or np.ptp(x) <= 0.0:
        raise IdentificationError(
            f"bellows test: {x.size} usable points; at least {FEWEST_POINTS} at different compressions are needed"
        )
    used = np.ones(x.size, bool)
    for _ in range(10):
        slope, offset = np.polyfit(x[used], y[used], 1)
        residual = y - offset - slope * x
        keep = np.abs(residual) <= OUTLIER * max(scale_of(residual[used]), 1e-9)
        if np.array_equal(keep, used) or keep.sum() < FEWEST_POINTS:
            break
        used = keep
    if slope <= 0.0:
        raise IdentificationError(
            "bellows test: the force decreases with compression; record both with positive signs"
        )
    freedom = int(used.sum()) - 2
    worth = dependence(residual[used])
    noise = np.sqrt(worth * np.sum(residual[used] ** 2) / freedom)
    deviation = float(noise / np.sqrt(np.sum((x[used] - x[used].mean()) ** 2)))
    half = quantile(freedom / worth) * deviation
    estimate = Estimate(float(slope), float(slope - half), float(slope + half))
    return BellowsFit(estimate, float(offset), x, y)
