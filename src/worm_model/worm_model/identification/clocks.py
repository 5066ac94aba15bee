# SPDX-License-Identifier: Apache-2.0
"""How well a run's clock offsets are told: of the camera against the servo, of the power sensor against the camera."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from worm_model.arrays import Array
from worm_model.identification.block_least_squares import (
    Problem,
    Solution,
    inverse,
    normal_equations,
)

TOLD = 0.5  # of what was assumed before the data: a deviation above it is mostly the assumption


def clock_deviations(
    problem: Problem, solution: Solution, entry: int, weights: Sequence[Array] | None = None
) -> Array:
    """(runs,) standard deviations in s of the nuisance ``entry`` of each run.

    From the curvature of the cost, which does not jump in an offset; all other parameters are open.
    """
    matrix, _ = normal_equations(problem, solution, weights)
    own = solution.own.shape[1]
    deviation: Array = np.sqrt(np.diag(inverse(matrix))[len(problem.shared) + entry :: own])
    return deviation


def told(deviation: Array, prior: float) -> Array:
    """The deviations, NaN where the data tell hardly more than the ``prior`` one."""
    return np.where(deviation <= TOLD * prior, deviation, np.nan)
