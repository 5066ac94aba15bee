# SPDX-License-Identifier: Apache-2.0
"""The exhaustive map of the box of gaits, refined where the groove count changes: the true front.

Speed is n·d·f and power grows with the stroke, so the best gaits of a branch (n grooves a cycle) lie on
its border with the next lower one. A grid finds the branches; each border between neighbours of a
column (one frequency) is bisected; columns are inserted where the branches change from one column to the
next; and between columns the borders, smooth there, are followed at many frequencies.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from worm_optimizer.search.optimizer_errors import OptimizerError
from worm_optimizer.search.pareto import front_of
from worm_optimizer.search.task import Array, Points, Task

_STEPS_ABOVE = (1.0, 4.0, 16.0, 64.0)  # tolerances above a followed border at which gaits are tried
_INSERTIONS = 8  # passes of inserted columns; each halves the uncertainty in frequency


@dataclass(frozen=True)
class MapSettings:
    """Resolution of the map.

    ``strokes`` × ``frequencies`` of its grid, ``tolerance`` in m of a border's stroke, ``followed``
    frequencies between neighbouring columns at which the borders are followed.
    """

    strokes: int = 41
    frequencies: int = 65
    tolerance: float = 2e-6
    followed: int = 7

    def __post_init__(self) -> None:
        if self.strokes < 3 or self.frequencies < 2 or self.followed < 0:
            raise OptimizerError(
                f"map: {self.strokes} strokes, {self.frequencies} frequencies, {self.followed} followed: "
                "give at least 3, 2 and 0"
            )
        if not 0.0 < self.tolerance < 1e-2:
            raise OptimizerError(
                f"map: tolerance {self.tolerance} m is not above 0 and below 0.01 m"
            )


@dataclass(frozen=True)
class GaitMap:
    """All gaits that were evaluated, and the front that they make."""

    points: Points
    front: Points

    @property
    def branches(self) -> tuple[int, ...]:
        """Grooves per cycle of the front's branches, rising."""
        return branches_of(self.front)


def branches_of(front: Points) -> tuple[int, ...]:
    """Grooves per cycle that occur in a front, rising."""
    return tuple(int(n) for n in np.unique(front.branch))


def build_map(task: Task, settings: MapSettings) -> GaitMap:
    """Maps a task's box; a few thousand gaits with the default settings."""
    columns = np.linspace(
        task.bounds.frequency_low, task.bounds.frequency_high, settings.frequencies
    )
    strokes = np.linspace(task.bounds.stroke_low, task.bounds.stroke_high, settings.strokes)
    grid = [axis.ravel() for axis in np.meshgrid(strokes, columns)]
    points = _refined(task, task.points(*grid), settings)
    for _ in range(_INSERTIONS):
        frequencies, seeds = _insertions(points, strokes, settings)
        if not frequencies.size:
            break
        points = _refined(task, Points.join(points, task.points(seeds, frequencies)), settings)
    points = Points.join(points, _followed_borders(task, points, settings))
    return GaitMap(points, front_of(points))


def _refined(task: Task, points: Points, settings: MapSettings) -> Points:
    """Halves the interval between neighbours of a column on different branches down to the tolerance."""
    while True:
        order = np.lexsort((points.stroke, points.frequency))
        points = points.take(order)
        below, above = slice(None, -1), slice(1, None)
        gap = points.stroke[above] - points.stroke[below]
        border = (
            (points.frequency[above] == points.frequency[below])
            & (gap > settings.tolerance)
            & (
                (points.branch[above] != points.branch[below])
                | (points.admissible[above] != points.admissible[below])
            )
        )
        if not border.any():
            return points
        middle = points.stroke[below][border] + 0.5 * gap[border]
        points = Points.join(points, task.points(middle, points.frequency[below][border]))


@dataclass(frozen=True)
class Borders:
    """The lowest admissible stroke of each branch in each column.

    ``frequency`` (c,) in Hz, rising; ``branch`` (b,); ``stroke`` (b, c) in m, NaN where a column lacks a
    branch.
    """

    frequency: Array
    branch: tuple[int, ...]
    stroke: Array


def borders_of(points: Points) -> Borders:
    """The borders that the evaluated gaits show."""
    admissible = points.take(points.admissible)
    frequency, column = np.unique(points.frequency, return_inverse=True)
    branch = branches_of(admissible)
    stroke = np.full((len(branch), frequency.size), np.inf)
    row = np.searchsorted(branch, admissible.branch)
    np.minimum.at(stroke, (row, column[points.admissible]), admissible.stroke)
    return Borders(frequency, branch, np.where(np.isfinite(stroke), stroke, np.nan))


def _insertions(points: Points, strokes: Array, settings: MapSettings) -> tuple[Array, Array]:
    """Frequencies and strokes of the columns to insert where neighbouring columns differ in their borders.

    An inserted column has the strokes of the grid and, since a branch may end in a tip thinner than the
    grid, those near its neighbours' borders.
    """
    borders = borders_of(points)
    left, right = borders.stroke[:, :-1], borders.stroke[:, 1:]
    jump = np.abs(left - right) > 2.0 * (strokes[1] - strokes[0])
    differs = np.any((np.isnan(left) != np.isnan(right)) | jump, axis=0)
    near = settings.tolerance * np.array(_STEPS_ABOVE)
    frequencies, seeds = [np.empty(0)], [np.empty(0)]
    for column in np.flatnonzero(differs):
        edges = borders.stroke[:, column : column + 2]
        edges = edges[np.isfinite(edges)]
        wanted = np.concatenate([strokes, np.add.outer(edges, near).ravel()])
        wanted = np.unique(np.minimum(wanted, strokes[-1]))
        middle = 0.5 * (borders.frequency[column] + borders.frequency[column + 1])
        frequencies.append(np.full(wanted.size, middle))
        seeds.append(wanted)
    return np.concatenate(frequencies), np.concatenate(seeds)


def _followed_borders(task: Task, points: Points, settings: MapSettings) -> Points:
    """Gaits just above the borders between the columns, at evenly spaced frequencies."""
    borders = borders_of(points)
    low, high = borders.frequency[0], borders.frequency[-1]
    count = (settings.frequencies - 1) * (settings.followed + 1) + 1
    frequency = np.setdiff1d(np.linspace(low, high, count), borders.frequency)
    stroke = np.array([np.interp(frequency, borders.frequency, row) for row in borders.stroke])
    stroke = stroke.reshape(len(borders.branch), 1, frequency.size)
    tried = stroke + settings.tolerance * np.array(_STEPS_ABOVE)[:, np.newaxis]
    tried = np.minimum(tried, task.bounds.stroke_high)
    frequencies = np.broadcast_to(frequency, tried.shape)
    known = np.isfinite(tried)
    return task.points(tried[known], frequencies[known])
