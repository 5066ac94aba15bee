# SPDX-License-Identifier: Apache-2.0
"""Corners: the gait of a branch with the shortest stroke at a given frequency, contraction share and ramp share.

The command swings between the pretension o and the reach o + S. To gain its grooves, a gait needs a reach above one
border and a pretension below another. Both borders are steps of the groove count. Along each border, the stroke and the
power decrease towards the corner in which the borders meet. `corners` locates the corner by bisecting the reach and
the pretension in turn.

With short ramps, a gait at a high frequency or with a large margin may gain its grooves at no pretension. The given
ramp share is therefore a lower bound: if no pretension suffices, the ramps become as long as necessary. The power
thus remains a continuous function of the contraction share and the ramp share.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from worm_model.errors import InputError
from worm_msgs.gait import CONTRACTION_SHARE_RANGE, MAX_PRETENSION, RAMP_SHARE_RANGE, Profile
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

# Accuracies in m to which successive rounds locate the borders. The position of each border depends on the position of
# the other, so each round locates both. If longer ramps replace the pretension, the borders meet at a small angle. The
# accuracies of successive rounds must then not differ too much.
COARSE = (8e-4, 1e-4, 1.25e-5, 1.6e-6)
FINE = (*COARSE, EDGE_TOLERANCE)
_WINDOW = (
    3.0  # size of the window in which a border is located again, relative to the previous accuracy
)
_RAMP_PER_METRE = 30.0  # change of the ramp share for a tightness change of 1 m, see `_Problem`
# Gaits are tried at reaches from the longest one down to one pitch less. Number of equal steps between these reaches
_REACHES = 16
_PRETENSIONS = 4  # number of pretensions that are tried, in steps of a quarter of the pitch
# Longer ramps that are tried at the least pretension, from 0 (the given ramp share) to 1 (the longest ramps)
_RAMP_PARTS = (1.0, 0.925)
# Number of steps between the reaches that are tried with these longer ramps. Near the end of a branch, a gait gains the
# grooves only in a narrow range of reaches.
_REACHES_OF_RAMPS = 48


@dataclass(frozen=True)
class ShapeBounds:
    """Bounds (low, high) of the pretension in m, the contraction share and the ramp share.

    Raises `InputError` unless low ≤ high and both are admissible for a gait.
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
                raise InputError(
                    f"bounds: {name} from {low:g} to {high:g}: give values from {least:g} to {most:g}, the lower first"
                )

    @property
    def include_sinusoid(self) -> bool:
        """True if the bounds permit the paper's waveform. Ramps do not matter, because a cosine has none."""
        low, high = self.contraction_share
        return self.pretension[0] == 0.0 and low <= 0.5 <= high

    @property
    def shares(self) -> Array:
        """Bounds of contraction share and ramp share, shape (2, 2), one row (low, high) for each."""
        return np.array([self.contraction_share, self.ramp_share])


@dataclass(frozen=True)
class Columns:
    """Problems that are solved at the same time; every field has shape (n,).

    A problem is to locate the corner of one branch at one frequency, with one margin and one profile.

    Attributes:
        frequency: frequency, Hz.
        margin: margin, m.
        count: grooves to be gained in all averaged cycles together.
        profile: profile, as the number in `Profile`.
    """

    frequency: Array
    margin: Array
    count: Index
    profile: Array

    @property
    def has_ramps(self) -> Mask:
        """True for profiles with a ramp share."""
        return self.profile != Profile.COSINE

    def take(self, rows: Index | Mask) -> Columns:
        """Return the rows (integers or a mask)."""
        return Columns(*(getattr(self, row.name)[rows] for row in dataclasses.fields(self)))

    @staticmethod
    def join(*parts: Columns) -> Columns:
        """Return the rows of all parts, in order."""
        names = [row.name for row in dataclasses.fields(Columns)]
        return Columns(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


NO_COLUMNS = Columns(np.empty(0), np.empty(0), np.empty(0, dtype=np.int64), np.empty(0))


def corners(
    task: MarginTask,
    bounds: ShapeBounds,
    columns: Columns,
    shares: Array,
    widths: tuple[float, ...],
) -> tuple[Points, Mask]:
    """Locate the corner of each problem, in one round for each accuracy in ``widths`` (m).

    ``shares`` (n, 2) contains the contraction share and the ramp share of each problem. The gaits may violate the
    actuator limits of the task.

    Returns:
        The gaits, slightly on the safe side of both borders, and a mask that is True for the gaits that gain the
        count of their problem.
    """
    problem = _Problem(task, bounds, columns, shares)
    found, tightness, reach = problem.started()
    rows = np.flatnonzero(found)
    tightness[rows], reach[rows] = problem.located(rows, tightness[rows], reach[rows], widths)
    shape = problem.shape_of(np.arange(found.size), tightness)
    points = task.points(reach - shape["pretension"], columns.frequency, shape, columns.margin)
    return points, found & (points.count >= columns.count)


def most_gained(task: MarginTask, bounds: ShapeBounds, columns: Columns, shares: Array) -> Index:
    """Return the largest number of grooves (n,) that gaits with ``shares`` (n, 2) gain at any place of `_starts`.

    The counts of ``columns`` are ignored.
    """
    problem, size = _Problem(task, bounds, columns, shares), len(shares)
    gained = np.zeros(size, dtype=np.int64)
    for above, reach in _starts(task, bounds):
        found = problem.gained(np.arange(size), np.full(size, above), np.full(size, reach))
        gained = np.maximum(gained, found)
    return gained


@dataclass(frozen=True)
class _Problem:
    """Gaits with given shares, as functions of the tightness (m) and the reach (m).

    The tightness combines pretension and ramp share in one variable. If it is positive, it is the pretension minus the
    least pretension. If it is negative, the pretension is the least one, and the ramp share exceeds the given one by
    `_RAMP_PER_METRE` times the absolute value of the tightness.
    """

    task: MarginTask
    bounds: ShapeBounds
    columns: Columns
    shares: Array

    @cached_property
    def loosest(self) -> Array:
        """Tightness (n,) with the longest ramps; 0 for a cosine, which has no ramps."""
        longest = self.bounds.ramp_share[1]
        return np.where(self.columns.has_ramps, self.shares[:, 1] - longest, 0.0) / _RAMP_PER_METRE

    def shape_of(self, rows: Index, tightness: Array) -> Shapes:
        """Return the shapes (m,) of the rows (m,) at values of the tightness (m,)."""
        share, ramp = self.shares[rows].T
        ramp = ramp + _RAMP_PER_METRE * np.maximum(-tightness, 0.0)
        return shapes_of(
            rows.size,
            pretension=self.bounds.pretension[0] + np.maximum(tightness, 0.0),
            contraction_share=share,
            profile=self.columns.profile[rows],
            ramp_share=np.minimum(ramp, self.bounds.ramp_share[1]),
        )

    def gained(self, rows: Index, tightness: Array, reach: Array) -> Index:
        """Return the grooves (m,) that the gaits of the rows (m,) gain in all averaged cycles together."""
        own, shape = self.columns.take(rows), self.shape_of(rows, tightness)
        stroke = reach - shape["pretension"]
        return gained_of(self.task.table(stroke, own.frequency, own.margin, shape=shape))

    def keeps(self, rows: Index, tightness: Array, reach: Array) -> Mask:
        """Return a mask (m,) that is True for the rows (m,) whose gaits gain their grooves."""
        return self.gained(rows, tightness, reach) >= self.columns.count[rows]

    def started(self) -> tuple[Mask, Array, Array]:
        """Find a gait of each row that gains its grooves.

        Return a mask that is True for rows with such a gait, and the tightness and reach of the gaits, (n,) each.
        """
        size = self.columns.count.size
        found, tightness = np.zeros(size, dtype=bool), np.zeros(size)
        reach = np.full(size, self.task.bounds.stroke_high)
        for places in _places(self.task, self.bounds):
            has_longer_ramps = np.any(places[:, 0] > 0.0)
            open_ = np.flatnonzero(~found & (~has_longer_ramps | (self.loosest < 0.0)))
            part, above, value = np.tile(places, (open_.size, 1)).T
            tried = part * np.repeat(self.loosest[open_], len(places)) + above
            kept = self.keeps(np.repeat(open_, len(places)), tried, value)
            kept = kept.reshape(-1, len(places))
            own, any_kept = np.arange(open_.size) * len(places), kept.any(axis=1)
            first = (own + np.argmax(kept, axis=1))[any_kept]
            rows = open_[any_kept]
            found[rows], tightness[rows], reach[rows] = True, tried[first], value[first]
        return found, tightness, reach

    def located(
        self, rows: Index, tightness: Array, reach: Array, widths: tuple[float, ...]
    ) -> tuple[Array, Array]:
        """Locate the corners of the rows, starting from gaits that gain their grooves. Return tightness and reach."""
        least, low = self.task.bounds.stroke_low, self.bounds.pretension[0]
        highest = min(self.bounds.pretension[1], self.task.bounds.stroke_high - least) - low
        shortest = low + np.maximum(tightness, 0.0) + least
        longest, tightest = reach, np.full(rows.size, highest)
        for width in widths:

            def reaches(part: Index, value: Array, at: Array = tightness) -> Mask:
                return self.keeps(rows[part], at[part], value)

            reach = np.minimum(_bisected(reaches, reach, shortest, width) + width, longest)
            tightest = np.minimum(tightest, reach - least - low)

            def extends(part: Index, value: Array, at: Array = reach) -> Mask:
                return self.keeps(rows[part], value, at[part])

            tightness = _bisected(extends, tightness, tightest, width)
            shortest = np.maximum(
                reach - (_WINDOW + 1.0) * width, low + np.maximum(tightness, 0.0) + least
            )
            tightest = np.minimum(tightness + _WINDOW * width, highest)
        safe = np.maximum(tightness - EDGE_ALLOWANCE, self.loosest[rows])
        return safe, np.minimum(reach + EDGE_ALLOWANCE, longest)


def _places(task: MarginTask, bounds: ShapeBounds) -> list[Array]:
    """Return groups of places (n, 3) at which a gait is tried, in the order of the trials.

    A place is (lengthening of the ramps, from 0 to 1 as in `_RAMP_PARTS`; pretension minus the least pretension, m;
    reach, m). For most gaits, the first place suffices.
    """
    places = [(0.0, *start) for start in _starts(task, bounds)]
    longer = [
        [(part, 0.0, reach) for reach in _reaches(task, bounds.pretension[0], _REACHES_OF_RAMPS)]
        for part in _RAMP_PARTS
    ]
    groups = places[:1], places[1:_REACHES], places[_REACHES:], *longer
    return [np.array(group) for group in groups if group]


def _starts(task: MarginTask, bounds: ShapeBounds) -> list[tuple[float, float]]:
    """Return the pairs (pretension minus the least pretension, reach) in m at which a gait is tried.

    Pretensions rise from the least one, and reaches fall from the longest one. Shorter reaches are needed because near
    the highest frequency or largest margin of a branch, a long stroke loses the grooves.
    """
    low, high = bounds.pretension
    above = np.arange(_PRETENSIONS) * task.parameters.pitch / _PRETENSIONS
    return [
        (pretension, reach)
        for pretension in above[low + above <= high].tolist()
        for reach in _reaches(task, low + pretension, _REACHES)
    ]


def _reaches(task: MarginTask, pretension: float, parts: int) -> list[float]:
    """Return reaches in m, from the longest one down to one pitch less, in ``parts`` equal steps."""
    reaches = task.bounds.stroke_high - np.arange(parts + 1) * task.parameters.pitch / parts
    return [float(reach) for reach in reaches if reach >= pretension + task.bounds.stroke_low]


def _bisected(
    keeps: Callable[[Index, Array], Mask], good: Array, bad: Array, width: float
) -> Array:
    """Bisect between ``good`` and ``bad`` values (n,) until they differ by at most ``width``. Return the good values.

    ``keeps`` returns True for good values. Its arguments are indices (m,) and values (m,).
    """
    good, bad = good.copy(), bad.copy()
    while (open_ := np.flatnonzero(np.abs(good - bad) > width)).size:
        middle = 0.5 * (good[open_] + bad[open_])
        kept = keeps(open_, middle)
        good[open_[kept]], bad[open_[~kept]] = middle[kept], middle[~kept]
    return good
