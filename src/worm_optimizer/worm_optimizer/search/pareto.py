# SPDX-License-Identifier: Apache-2.0
"""Pareto order of gaits by speed (higher is better) and power (lower is better) of eq:moo_formulation."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from worm_optimizer.evaluation.task import Index, Points


def non_dominated(speed: ArrayLike, power: ArrayLike) -> Index:
    """Return the indices of the non-dominated rows, by rising speed; one index for equal rows.

    ``speed`` in m/s and ``power`` in W have shape (n,) and contain no NaN.
    """
    speeds, powers = np.asarray(speed, dtype=float), np.asarray(power, dtype=float)
    order = np.lexsort((-speeds, powers))
    best = np.maximum.accumulate(np.concatenate(([-np.inf], speeds[order])))
    return order[speeds[order] > best[:-1]].astype(np.int64)


def front_of(points: Points) -> Points:
    """Return the admissible non-dominated gaits, by rising speed.

    Speeds are compared by grooves per second, so that a transient which has not ended does not affect the comparison.
    """
    admissible = points.take(points.admissible)
    return admissible.take(non_dominated(admissible.count * admissible.frequency, admissible.power))
