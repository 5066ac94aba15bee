# SPDX-License-Identifier: Apache-2.0
"""Stage 2: bellows stiffness k_b from a force–deformation test."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from worm_model.arrays import Array
from worm_model.identification.estimate import Estimate, quantile
from worm_model.identification.identification_errors import IdentificationError
from worm_model.identification.robust import OUTLIER, dependence, scale_of

COLUMNS = ("compression_m", "force_N")
FEWEST_POINTS = 5


@dataclass(frozen=True)
class BellowsFit:
    """A straight line through the test: ``stiffness`` N/m, ``offset`` N at no compression (the load cell's zero).

    ``compression``, ``force`` (n,) are the test's samples.
    """

    stiffness: Estimate
    offset: float
    compression: Array
    force: Array


def fit_bellows(compression: Array, force: Array) -> BellowsFit:
    """Least squares without outliers; the interval is that of Student's t, exact for white noise.

    Where residuals resemble their neighbours (hysteresis), it is that of as many independent ones as they are worth.
    The load cell's scale is taken as true. ``compression`` m and ``force`` N, (n,) each, in the order in which
    they were taken. Raises `IdentificationError` if no stiffness comes out.
    """
    known = np.isfinite(compression) & np.isfinite(force)
    x, y = compression[known], force[known]
    if x.size < FEWEST_POINTS or np.ptp(x) <= 0.0:
        raise IdentificationError(
            f"bellows test: {x.size} usable points at different compressions, {FEWEST_POINTS} are needed"
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
            "bellows test: the force falls with compression; give compression and force as positive"
        )
    freedom = int(used.sum()) - 2
    worth = dependence(residual[used])
    noise = np.sqrt(worth * np.sum(residual[used] ** 2) / freedom)
    deviation = float(noise / np.sqrt(np.sum((x[used] - x[used].mean()) ** 2)))
    half = quantile(freedom / worth) * deviation
    estimate = Estimate(float(slope), float(slope - half), float(slope + half))
    return BellowsFit(estimate, float(offset), x, y)
