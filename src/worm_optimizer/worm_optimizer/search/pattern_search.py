# SPDX-License-Identifier: Apache-2.0
"""Pattern search for the contraction share and ramp share with the lowest power within the limits of the hardware."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from worm_optimizer.evaluation.task import Array, Index, Mask, Points

FORBIDDEN = 1e6  # least cost of a gait that violates a limit, W
_FIRST_STEPS = (0.08, 0.1)  # changes of contraction share and ramp share in a step of 1
LEAST_STEP = 0.015  # usual last step of a search, relative to _FIRST_STEPS
_SHRINK = 0.4  # factor by which the steps of a pattern shrink
_MOST_ROUNDS = 30
# Eight neighbours of the centre of a pattern, in steps of (contraction share, ramp share)
_PATTERN = np.array([(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j], dtype=float)
_FARTHEST = 1.5  # largest distance of the minimum of a quadratic from the centre, in steps
_SPARE = 3e-5  # amount by which the predicted violation stays below 0
_GRIDS = 3  # number of grids on which limited quadratics are minimised, each around the best point of the previous grid
_GRID = np.linspace(-1.0, 1.0, 13)  # points of a grid along each share, relative to its half-width


@dataclass(frozen=True)
class Costs:
    """Costs of gaits: ``power`` in W, infinite for a missing gait, and ``violation`` as in `Points`."""

    power: Array
    violation: Array

    @property
    def total(self) -> Array:
        """Power in W. Gaits beyond a limit cost more than all others; missing gaits cost infinity."""
        return np.where(self.violation > 0.0, FORBIDDEN * (1.0 + self.violation), self.power)


def costs_of(points: Points, found: Mask) -> Costs:
    """Return the costs of gaits. Gaits for which the mask ``found`` is False count as missing."""
    return Costs(np.where(found, points.power, np.inf), np.where(found, points.violation, -1.0))


def improve(
    cost_of: Callable[[Index, Array], Costs],
    has_ramps: Mask,
    bounds: Array,
    shares: Array,
    steps: tuple[float, float],
) -> tuple[Array, Costs]:
    """Search the shares (n, 2) with the lowest costs, for all problems at once.

    Each round evaluates the eight neighbours (the pattern) of the best point so far, fits a quadratic to the costs, and
    evaluates the minimum of the quadratic. If a point violates a limit, a second quadratic is fitted to the violations,
    and only points at which it predicts no violation qualify as the minimum. The best of all evaluated points is the
    centre of the next pattern. The pattern shrinks if its centre remains the best point, or if the minimum of the
    quadratic is the best point and lies within the pattern.

    Args:
        cost_of: returns the costs (m,). Arguments: indices of the problems (m,), and shares (m, 2).
        has_ramps: True for the problems whose ramp share is searched, shape (n,).
        bounds: bounds of contraction share and ramp share, shape (2, 2).
        shares: start of the search, shape (n, 2).
        steps: first and least step, relative to `_FIRST_STEPS`.

    Returns:
        The shares (n, 2) and their costs (n,).
    """
    best, known = shares.copy(), cost_of(np.arange(len(shares)), shares)
    power, violation = known.power.copy(), known.violation.copy()
    step = np.where(np.isfinite(power), steps[0], 0.0)
    for _ in range(_MOST_ROUNDS):
        active = np.flatnonzero(step >= steps[1])
        if not active.size:
            break
        own, size = best[active], step[active, np.newaxis] * _FIRST_STEPS

        def at(moves: Array, own: Array = own, size: Array = size) -> Array:
            return np.clip(own + size * moves, bounds[:, 0], bounds[:, 1])

        tried = at(_PATTERN[:, np.newaxis]).swapaxes(0, 1)  # (active, pattern, 2)
        useful = has_ramps[active][:, np.newaxis] | (_PATTERN[:, 1] == 0.0)
        useful &= np.any(tried != own[:, np.newaxis], axis=2)
        around = Costs(np.full(useful.shape, np.inf), np.full(useful.shape, -1.0))
        which = np.nonzero(useful)
        found = cost_of(active[which[0]], tried[which])
        around.power[which], around.violation[which] = found.power, found.violation
        moves = _minimum(Costs(power[active], violation[active]), around)
        candidate = at(moves)
        last = cost_of(active, candidate)
        options = np.concatenate([own[:, np.newaxis], tried, candidate[:, np.newaxis]], axis=1)
        costs = Costs(
            np.column_stack([power[active], around.power, last.power]),
            np.column_stack([violation[active], around.violation, last.violation]),
        )
        choice = np.argmin(costs.total, axis=1)
        rows = np.arange(active.size)
        best[active] = options[rows, choice]
        power[active], violation[active] = costs.power[rows, choice], costs.violation[rows, choice]
        inside = np.all(np.abs(moves) <= 1.0, axis=1)
        ends = (choice == 0) | ((choice > len(_PATTERN)) & inside)
        step[active] *= np.where(ends, _SHRINK, 1.0)
    return best, Costs(power, violation)


def _minimum(centre: Costs, around: Costs) -> Array:
    """Return the predicted minimum (n, 2) of each pattern, in steps from its centre; 0 without a prediction."""
    minimum = _minimum_of_quadratic(centre.total, around.total)
    limited = np.isfinite(centre.power)
    limited &= np.maximum(centre.violation, around.violation.max(axis=1)) > 0.0
    rows = np.flatnonzero(limited)
    if rows.size:
        minimum[rows] = _minimum_within_limits(
            Costs(centre.power[rows], centre.violation[rows]),
            Costs(around.power[rows], around.violation[rows]),
        )
    return minimum


def _minimum_of_quadratic(centre: Array, table: Array) -> Array:
    """Return the minimum (n, 2) of the quadratic through each pattern, in steps from its centre, or 0 without one."""
    low_low, low, low_high, down, up, high_low, high, high_high = table.T
    with np.errstate(invalid="ignore", divide="ignore"):
        slope = 0.5 * np.stack([high - low, up - down])
        xx, yy = high + low - 2.0 * centre, up + down - 2.0 * centre
        xy = 0.25 * (high_high - high_low - low_high + low_low)
        determinant = xx * yy - xy * xy
        usable = (table.max(axis=1) < FORBIDDEN) & (xx > 0.0) & (determinant > 1e-9 * xx * xx)
        both = np.stack([xy * slope[1] - yy * slope[0], xy * slope[0] - xx * slope[1]])
        # At a bound of the ramp share, and for a cosine, only the contraction share can change.
        single = (np.maximum(high, low) < FORBIDDEN) & (xx > 0.0)
        alone = np.stack([-slope[0] / xx, np.zeros_like(xx)])
        minimum = np.where(usable, both / determinant, np.where(single, alone, 0.0))
    return np.clip(np.nan_to_num(minimum), -_FARTHEST, _FARTHEST).T


def _minimum_within_limits(centre: Costs, around: Costs) -> Array:
    """Return the point (n, 2), in steps from the centre, with the lowest predicted power and no predicted violation.

    Power and violation are predicted by quadratics through each pattern.
    """
    known = np.isfinite(around.power)
    _, low, _, down, up, _, high, _ = known.T
    free = np.stack(
        [low & high, down & up], axis=1
    )  # shares with evaluated neighbours on both sides
    mixed = np.all(known, axis=1)
    power = _quadratic(centre.power, around.power, free, mixed)
    violation = _quadratic(centre.violation, around.violation, free, mixed)
    rows, size = np.arange(len(free)), _FARTHEST
    place = np.zeros(free.shape)
    offsets = np.stack(np.meshgrid(_GRID, _GRID), axis=-1).reshape(-1, 2)
    for _ in range(_GRIDS):
        at = np.clip(place[:, np.newaxis] + size * offsets, -_FARTHEST, _FARTHEST)
        at *= free[:, np.newaxis]
        predicted = Costs(_value(power, at), _value(violation, at) + _SPARE)
        place = at[rows, np.argmin(predicted.total, axis=1)]
        size *= _GRID[1] - _GRID[0]
    return place


def _quadratic(centre: Array, table: Array, free: Mask, mixed: Mask) -> Array:
    """Return the coefficients (6, n) of 1, x, y, x², y² and x·y of the quadratic through each pattern.

    Coefficients of a share that is not ``free`` (n, 2) are 0. The coefficient of x·y is 0 unless ``mixed`` (n,).
    """
    low_low, low, low_high, down, up, high_low, high, high_high = table.T
    with np.errstate(invalid="ignore"):
        x, y = 0.5 * (high - low), 0.5 * (up - down)
        xx, yy = 0.5 * (high + low) - centre, 0.5 * (up + down) - centre
        xy = 0.25 * (high_high - high_low - low_high + low_low)
    along, across = free.T
    return np.stack(
        [
            centre,
            np.where(along, x, 0.0),
            np.where(across, y, 0.0),
            np.where(along, xx, 0.0),
            np.where(across, yy, 0.0),
            np.where(mixed, xy, 0.0),
        ]
    )


def _value(coefficients: Array, at: Array) -> Array:
    """Return the values (n, m) of quadratics with ``coefficients`` (6, n) at points (n, m, 2)."""
    one, x, y, xx, yy, xy = coefficients[:, :, np.newaxis]
    u, v = at[:, :, 0], at[:, :, 1]
    return one + u * (x + xx * u + xy * v) + v * (y + yy * v)
