# SPDX-License-Identifier: Apache-2.0
"""Corners: at a frequency and for the shares of a shape, the gait of a branch with the shortest stroke.

The command swings between the pretension o and the reach o + S. To gain its grooves, a gait needs a reach above one
border and a pretension below another. Both borders are steps of the groove count. Along each border the stroke and the
power decrease towards the corner in which the borders meet. `corners` locates the corner by bisection along both
borders in turn.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from worm_model.gait import CONTRACTION_SHARE_RANGE, MAX_PRETENSION, RAMP_SHARE_RANGE
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

# Accuracies in m of successive rounds. Each round locates both borders, as the location of one depends on the other.
COARSE = (2e-5, 1e-6)
FINE = (*COARSE, EDGE_TOLERANCE)
_WINDOW = 50.0  # size of the window in which a border is located again, relative to the last width
_REACHES = 16  # tried reaches below the longest one, a sixteenth of the pitch apart
_PRETENSIONS = 4  # tried pretensions from the least one on, a quarter of the pitch apart


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
    """Locate the corners of shapes with ``shares`` (n, 2), in one round for each accuracy in ``widths`` (m).

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
    for least_contraction, value in starts_of(task, bounds):
        open_ = np.flatnonzero(~found)
        tried = np.full((2, open_.size), [[least_contraction], [value]])
        kept = open_[keeps(open_, *tried)]
        found[kept], pretension[kept], reach[kept] = True, least_contraction, value
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


def starts_of(task: MarginTask, bounds: ShapeBounds) -> list[tuple[float, float]]:
    """Return (pretension, reach) in m, rising and falling, at which a gait is tried.

    Shorter reaches and higher pretensions are needed because near the highest frequency or the largest margin of a
    branch, a long stroke loses the grooves.
    """
    (low, high), pitch = bounds.pretension, task.parameters.pitch
    pretensions = low + np.arange(_PRETENSIONS) * pitch / _PRETENSIONS
    reaches = task.bounds.stroke_high - np.arange(_REACHES + 1) * pitch / _REACHES
    return [
        (pretension, reach)
        for pretension in pretensions[pretensions <= high].tolist()
        for reach in reaches.tolist()
        if reach >= pretension + task.bounds.stroke_low
    ]


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
    """Return the last good values (n,), bisected between ``good`` and ``bad`` to within ``width``."""
    good, bad = good.copy(), bad.copy()
    while (open_ := np.flatnonzero(np.abs(good - bad) > width)).size:
        middle = 0.5 * (good[open_] + bad[open_])
        kept = keeps(open_, middle)
        good[open_[kept]], bad[open_[~kept]] = middle[kept], middle[~kept]
    return good
