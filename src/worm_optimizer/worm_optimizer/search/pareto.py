# SPDX-License-Identifier: Apache-2.0
"""Pareto order in the plane of speed (to be high) and power (to be low) of eq:moo_formulation."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from worm_optimizer.evaluation.task import Index, Points


def non_dominated(speed: ArrayLike, power: ArrayLike) -> Index:
    """Indices of the rows that no other row betters, by rising speed; equal rows are kept once.

    ``speed`` in m/s and ``power`` in W of shape (n,); none may be NaN.
    """
    speeds, powers = np.asarray(speed, dtype=float), np.asarray(power, dtype=float)
    order = np.lexsort((-speeds, powers))
    best = np.maximum.accumulate(np.concatenate(([-np.inf], speeds[order])))
    return order[speeds[order] > best[:-1]].astype(np.int64)


def front_of(points: Points) -> Points:
    """The admissible gaits that no other betters, by rising speed.

    They are compared by the grooves that they gain: what is left of the transient makes no gait faster than another.
    """
    admissible = points.take(points.admissible)
    return admissible.take(non_dominated(admissible.count * admissible.frequency, admissible.power))


def hypervolume(front: Points, reference_power: float) -> float:
    """Area in m/s·W that a front dominates between it and (0 m/s, ``reference_power`` W).

    ``front`` as `front_of` returns it; what lies above the reference power counts nothing.
    """
    height = np.maximum(reference_power - front.power, 0.0)
    width = np.diff(front.speed, prepend=0.0)
    return float(np.sum(width * height))
