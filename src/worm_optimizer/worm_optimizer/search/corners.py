# SPDX-License-Identifier: Apache-2.0
"""Corners: at a frequency and for the shares of a shape, the gait of a branch with the shortest stroke.

The command swings between the pretension o and the reach o + S. To gain its grooves, a gait needs a reach above one
border and a pretension below another. Both borders are steps of the groove count. Along each border the stroke and the
power decrease towards the corner in which the borders meet. `corners` locates the corner by bisection along both
borders in turn. `improve` searches the contraction share and the ramp share whose corner needs the lowest power.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from worm_model.gait import CONTRACTION_SHARE_RANGE, MAX_PRETENSION, RAMP_SHARE_RANGE, Profile
from worm_optimizer.evaluation.command_shape import Shapes, shapes_of
from worm_optimizer.evaluation.task import (
    EDGE_ALLOWANCE,
    EDGE_TOLERANCE,
    Array,
    Index,
    MarginTask,
    Mask,
    Points,
    gained_of,
)
from worm_optimizer.optimizer_errors import OptimizerError

# Widths in m to which both borders are located in turn, because each border depends on the position on the other one.
COARSE = (2e-5, 1e-6)
FINE = (*COARSE, EDGE_TOLERANCE)
_WINDOW = 50.0  # size of the window in which a border is located again, relative to the last width
_REACHES = 8  # tried reaches below the longest one, an eighth of the pitch apart
_FIRST_STEPS = (0.08, 0.1)  # first steps of contraction share and ramp share
_LEAST_STEP = 0.015  # step at which the search ends, relative to the first one
_SHRINK = 0.4
_MOST_ROUNDS = 30
FORBIDDEN = 1e6  # W, cost of a gait that violates a limit; it grows with the violation


@dataclass(frozen=True)
class ShapeBounds:
    """Box of the shapes: pretension in m, contraction share and ramp share, each (low, high).

    Raises `OptimizerError` unless low ≤ high within the limits of a gait.
    """

    pretension: tuple[float, float] = (0.0, MAX_PRETENSION)
    contraction_share: tuple[float, float] = (0.1, 0.9)
    ramp_share: tuple[float, float] = (0.1, 0.5)

    def __post_init__(self) -> None:
        for name, least, most in (
            ("pretension", 0.0, MAX_PRETENSION),
            ("contraction_share", *CONTRACTION_SHARE_RANGE),
            ("ramp_share", *RAMP_SHARE_RANGE),
        ):
            low, high = getattr(self, name)
            if not least <= low <= high <= most:
                raise OptimizerError(
                    f"bounds: {name} from {low:g} to {high:g}: give values from {least:g} to {most:g}, the lower first"
                )

    @property
    def include_sinusoid(self) -> bool:
        """True if the paper's gait is within the box. The ramps do not matter, because a cosine has none."""
        low, high = self.contraction_share
        return self.pretension[0] == 0.0 and low <= 0.5 <= high

    @property
    def shares(self) -> Array:
        """Bounds of contraction share and ramp share, shape (2, 2), one row (low, high) each."""
        return np.array([self.contraction_share, self.ramp_share])


@dataclass(frozen=True)
class Columns:
    """Problems that are solved at the same time; every field has shape (n,).

    ``frequency`` in Hz, ``margin`` in m, ``count``: grooves to be gained in all averaged cycles together, ``profile``:
    number of the profile.
    """

    frequency: Array
    margin: Array
    count: Index
    profile: Array

    def take(self, rows: Index | Mask) -> Columns:
        """Return the rows (integers or a mask)."""
        return Columns(*(getattr(self, row.name)[rows] for row in dataclasses.fields(self)))

    @staticmethod
    def join(*parts: Columns) -> Columns:
        """Return the rows of all parts, in order."""
        names = [row.name for row in dataclasses.fields(Columns)]
        return Columns(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


def corners(
    task: MarginTask,
    bounds: ShapeBounds,
    columns: Columns,
    shares: Array,
    widths: tuple[float, ...],
) -> tuple[Points, Mask]:
    """Locate the corners of shapes with ``shares`` (n, 2), to each of the ``widths`` in m in turn.

    The limits of the task are not considered.

    Returns:
        The gaits, slightly on the safe side of both borders, and a mask of those that gain the grooves.
    """
    least, most = task.bounds.stroke_low, task.bounds.stroke_high
    low, high = bounds.pretension

    def keeps(rows: Index, pretension: Array, reach: Array) -> Mask:
        own = columns.take(rows)
        shape = _shapes(own, shares[rows], pretension)
        table = task.table(reach - pretension, own.frequency, own.margin, shape=shape)
        return gained_of(table) >= own.count

    size, tightest = columns.count.size, min(high, most - least)
    pretension, reach = np.full(size, low), np.full(size, most)
    found = np.zeros(size, dtype=bool)
    for value in reaches_of(task, bounds):
        open_ = np.flatnonzero(~found)
        kept = open_[keeps(open_, pretension[open_], np.full(open_.size, value))]
        found[kept], reach[kept] = True, value
    rows = np.flatnonzero(found)
    o, top, longest = pretension[rows], reach[rows], reach[rows]
    short, tight = o + least, np.full(rows.size, tightest)
    for width in widths:

        def reaches(part: Index, value: Array, o: Array = o) -> Mask:
            return keeps(rows[part], o[part], value)

        top = np.minimum(_bisected(reaches, top, short, width) + width, longest)
        tight = np.minimum(tight, top - least)

        def returns(part: Index, value: Array, top: Array = top) -> Mask:
            return keeps(rows[part], value, top[part])

        o = _bisected(returns, o, tight, width)
        short = np.maximum(top - (_WINDOW + 1.0) * width, o + least)
        tight = np.minimum(o + _WINDOW * width, tightest)
    safe = np.maximum(o - EDGE_ALLOWANCE, low)
    pretension[rows], reach[rows] = safe, np.minimum(top + EDGE_ALLOWANCE, longest)
    shape = _shapes(columns, shares, pretension)
    points = task.points(reach - pretension, columns.frequency, shape, columns.margin)
    return points, found & (points.count >= columns.count)


def reaches_of(task: MarginTask, bounds: ShapeBounds) -> Array:
    """Return the reaches in m, falling, at which a gait with the least pretension is tried.

    Shorter reaches are needed because near the highest frequency of a branch, a long reach loses the grooves.
    """
    longest = task.bounds.stroke_high
    reaches = longest - np.arange(_REACHES + 1) * task.parameters.pitch / _REACHES
    return reaches[reaches >= bounds.pretension[0] + task.bounds.stroke_low]


def _shapes(columns: Columns, shares: Array, pretension: Array) -> Shapes:
    share, ramp = shares.T
    return shapes_of(
        pretension.size,
        pretension=pretension,
        contraction_share=share,
        profile=columns.profile,
        ramp_share=ramp,
    )


def _bisected(
    keeps: Callable[[Index, Array], Mask], good: Array, bad: Array, width: float
) -> Array:
    """Return values (n,) that keep the grooves, to within a width of the border or of the bad end."""
    good, bad = good.copy(), bad.copy()
    while (open_ := np.flatnonzero(np.abs(good - bad) > width)).size:
        middle = 0.5 * (good[open_] + bad[open_])
        kept = keeps(open_, middle)
        good[open_[kept]], bad[open_[~kept]] = middle[kept], middle[~kept]
    return good


def costs_of(points: Points, found: Mask) -> Array:
    """Return the power of gaits in W. Gaits beyond a limit cost more than all others; missing gaits cost infinity."""
    costs = np.where(points.violation > 0.0, FORBIDDEN * (1.0 + points.violation), points.power)
    return np.where(found, costs, np.inf)


def improve(
    cost_of: Callable[[Index, Array], Array],
    profile: Array,
    bounds: Array,
    shares: Array,
    first_step: float,
) -> tuple[Array, Array]:
    """Search the shares (n, 2) with the lowest costs, all problems at once.

    A pattern of eight neighbours moves to the best of them, or to the minimum of the quadratic through all of them.
    If neither is better, it shrinks.

    Args:
        cost_of: returns the costs of shares (m, 2) of the problems with the numbers (m,).
        profile: number of the profile of each problem, shape (n,); a cosine has no ramps.
        bounds: bounds of contraction share and ramp share, shape (2, 2).
        shares: start of the search, shape (n, 2).
        first_step: first step, relative to the usual one.

    Returns:
        The shares (n, 2) and their costs (n,).
    """
    best, cost = shares.copy(), cost_of(np.arange(len(shares)), shares)
    step = np.where(np.isfinite(cost), first_step, 0.0)
    pattern = np.array([(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j], dtype=float)
    for _ in range(_MOST_ROUNDS):
        active = np.flatnonzero(step >= _LEAST_STEP)
        if not active.size:
            break
        own, size = best[active], step[active, np.newaxis] * _FIRST_STEPS

        def at(moves: Array, own: Array = own, size: Array = size) -> Array:
            return np.clip(own + size * moves, bounds[:, 0], bounds[:, 1])

        tried = at(pattern[:, np.newaxis]).swapaxes(0, 1)  # (active, pattern, 2)
        useful = (profile[active] != Profile.COSINE)[:, np.newaxis] | (pattern[:, 1] == 0.0)
        useful &= np.any(tried != own[:, np.newaxis], axis=2)
        table = np.full(useful.shape, np.inf)
        which = np.nonzero(useful)
        table[which] = cost_of(active[which[0]], tried[which])
        candidate = at(_minimum_of_quadratic(cost[active], table))
        costs = np.column_stack([cost[active], table, cost_of(active, candidate)])
        options = np.concatenate([own[:, np.newaxis], tried, candidate[:, np.newaxis]], axis=1)
        choice = np.argmin(costs, axis=1)
        rows = np.arange(active.size)
        best[active], cost[active] = options[rows, choice], costs[rows, choice]
        moved = (choice > 0) & (choice <= len(pattern))
        step[active] *= np.where(moved, 1.0, _SHRINK)
    return best, cost


def _minimum_of_quadratic(centre: Array, table: Array) -> Array:
    """Return the minimum (n, 2) of the quadratic through each pattern, in steps, at most 1.5; 0 without a minimum."""
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
    return np.clip(np.nan_to_num(minimum), -1.5, 1.5).T
