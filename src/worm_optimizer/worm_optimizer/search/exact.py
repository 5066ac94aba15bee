# SPDX-License-Identifier: Apache-2.0
"""Exact front: the lower edges of all branches as functions of the frequency, and minima along these edges.

At a fixed frequency, the number of grooves gained is a step function of the stroke, and within a step the power rises
with the stroke. The Pareto set therefore consists of lower edges. An edge is the shortest stroke that gains a number of
grooves (the count) at a frequency. `survey` finds the edges at some frequencies (the columns). `minimise` finds
minima along the edges, which may lie between the columns.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from worm_model.errors import InputError
from worm_optimizer.evaluation.task import (
    Array,
    Bounds,
    Edges,
    Index,
    Mask,
    Points,
    Task,
)
from worm_optimizer.search.pareto import front_of

# Returns the cost to be minimised for each gait, shape (n,). The cost of a gait that does not satisfy the request, such
# as a minimum speed, is infinite.
Cost = Callable[[Points], Array]
# Returns edges of a task. Arguments: indices of brackets (n,), counts (n,), frequencies (n,) in Hz, and strokes
# (n, scan) in m between which the edges are searched. The result may also contain edges with other counts.
FindEdges = Callable[[Index, Index, Array, Array], Edges]

# A local minimum over the columns is refined if it exceeds the lowest one by at most this share. After the refinement,
# which includes frequencies between the columns, it may be the lowest. `_rivals` searches for a cheaper edge
# between two columns only if the power in one of them is at most this share above that of the gait of the front.
_NEAR_BEST = 0.02
_FASTER = 1e-12  # relative increase of the speed at which `_rivals` searches for cheaper gaits
_WINDOW_SCAN = 5  # number of strokes that are evaluated in the window around an edge
_LEAST_WINDOW = 1e-6  # least extension of a window beyond the known strokes of an edge, m
_LONGER = 4  # number of longer strokes per gait at which the rise of the power is verified


@dataclass(frozen=True)
class Resolution:
    """Resolution of the scan of the box: numbers of evenly spaced ``frequencies``, and ``strokes`` at each of them."""

    strokes: int = 41
    frequencies: int = 161

    def __post_init__(self) -> None:
        if self.strokes < 3 or self.frequencies < 2:
            raise InputError(
                f"resolution: {self.strokes} strokes, {self.frequencies} frequencies: give at least 3 and 2"
            )

    def columns(self, bounds: Bounds) -> Array:
        """Return the frequencies of the columns in Hz."""
        return np.unique(np.linspace(bounds.frequency_low, bounds.frequency_high, self.frequencies))


@dataclass(frozen=True)
class Zoom:
    """Refinement of a minimum: each of ``rounds`` rounds evaluates ``points`` frequencies, then narrows the bracket."""

    points: int = 17
    rounds: int = 6


@dataclass(frozen=True)
class Survey:
    """Edges of all branches: ``columns`` in Hz, rising, and ``points``, each at the frequency of a column."""

    columns: Array
    points: Points

    def joined(self, more: Points) -> Survey:
        """Return the survey with more edges."""
        columns = np.union1d(self.columns, more.frequency)
        return Survey(columns, Points.join(self.points, more))


@dataclass(frozen=True)
class Bracket:
    """Ranges of ``frequency`` (Hz) and ``stroke`` (m) with a minimum of the ``cost`` along the edge of a ``count``.

    ``owner`` is a number that the caller chooses to recognise the bracket.
    """

    count: int
    cost: Cost
    frequency: tuple[float, float]
    stroke: tuple[float, float]
    owner: int = 0


def survey(task: Task, resolution: Resolution, zoom: Zoom) -> Survey:
    """Find the edges of all branches at the columns, and at the highest frequencies of the branches on the front."""
    columns = resolution.columns(task.bounds)
    scan = np.linspace(task.bounds.stroke_low, task.bounds.stroke_high, resolution.strokes)
    edges = task.edges(columns, np.tile(scan, (columns.size, 1)))
    surveyed = _completed(task, Survey(columns, edges.points), float(scan[1] - scan[0]))
    ends = _ends(surveyed)
    return surveyed.joined(minimise(finder(task), ends, zoom)) if ends else surveyed


def _completed(task: Task, surveyed: Survey, step: float) -> Survey:
    """Return the survey with the edges that the scan missed because a branch is narrower than the ``step`` (m).

    A branch may lack an edge in a column, or have one at a clearly longer stroke than in the neighbouring column. Its
    edge is then searched near the straight line through the edges in the next two columns on one side. If the search
    succeeds, the next column on the other side is treated in the same way.
    """
    tried: set[tuple[int, int, int]] = set()
    while True:
        seeds = [seed for seed in _seeds(surveyed, step) if seed[:3] not in tried]
        tried |= {seed[:3] for seed in seeds}
        if not seeds:
            return surveyed
        columns = surveyed.columns[[place for _, place, _, _ in seeds]]
        near, beyond = np.array([strokes for *_, strokes in seeds]).T
        reach = np.maximum(2.0 * np.abs(near - beyond), step / 16.0)
        ahead = 2.0 * near - beyond  # extrapolation of a nearly straight edge
        scan = np.linspace(ahead - reach, ahead + reach, 2 * _WINDOW_SCAN, axis=1)
        counts = np.array([count for count, *_ in seeds])
        edges = task.edges(columns, scan, counts)
        found = edges.points.take(edges.points.count == counts[edges.column])
        surveyed = surveyed.joined(found)


def _seeds(surveyed: Survey, step: float) -> list[tuple[int, int, int, tuple[float, float]]]:
    """Return the columns in which `_completed` searches for edges.

    Each element is (count, index of the column, side of the columns with known edges, strokes in m of the edges in the
    next two columns on that side). The side is 1 for lower frequencies, and −1 for higher ones.
    """
    seeds = []
    for count in np.unique(surveyed.points.count):
        _, strokes = _by_column(surveyed, surveyed.points.stroke, int(count))
        for side in (-1, 1):
            near, beyond = (np.roll(strokes, by * side) for by in (1, 2))
            # The outermost columns lack these neighbours.
            near[0 if side > 0 else -1] = np.nan
            beyond[slice(None, 2) if side > 0 else slice(-2, None)] = np.nan
            missed = np.isfinite(near) & ~(strokes <= near + 0.5 * step)
            for place in np.flatnonzero(missed):
                pair = near[place], beyond[place] if np.isfinite(beyond[place]) else near[place]
                if abs(pair[0] - pair[1]) > step:
                    pair = near[place], near[place]
                seeds.append((int(count), int(place), side, pair))
    return seeds


def finder(task: Task) -> FindEdges:
    """Return the `FindEdges` function of a task, which ignores the indices of the brackets."""
    return lambda _, count, frequency, strokes: task.edges(frequency, strokes, count)


def speed_cost(points: Points) -> Array:
    """Return the negative speed in m/s."""
    return -points.speed


def power_cost(points: Points) -> Array:
    """Return the power in W."""
    return points.power


def transport_cost(points: Points) -> Array:
    """Return the cost of transport times the weight, in N."""
    return points.power / points.speed


_MINIMISED = (power_cost, transport_cost)  # costs whose minima belong to every front


def lowest(task: Task, surveyed: Survey, costs: Sequence[Cost], zoom: Zoom) -> Points:
    """Minimise each cost along the edges, continuously in the frequency.

    Return the local minima of each cost that are close to its lowest one. A cost for which no gait qualifies has none.
    """
    brackets = [bracket for cost in costs for bracket in brackets_of(surveyed, cost)]
    return minimise(finder(task), brackets, zoom)


def brackets_of(surveyed: Survey, cost: Cost, owner: int = 0) -> list[Bracket]:
    """Return brackets around those local minima of a cost over the columns that are close to the lowest one."""
    points, columns = surveyed.points, surveyed.columns
    costs = cost(points)
    least = costs.min(initial=np.inf)
    if not np.isfinite(least):
        return []
    brackets = []
    for count in np.unique(points.count):
        of_column, strokes = _by_column(surveyed, costs, int(count))
        padded = np.r_[np.inf, of_column, np.inf]
        low = (of_column <= padded[:-2]) & (of_column <= padded[2:])
        near = of_column <= least + _NEAR_BEST * abs(least)
        for place in np.flatnonzero(low & near & np.isfinite(of_column)).tolist():
            ends = max(place - 1, 0), min(place + 1, columns.size - 1)
            window = _window(strokes[ends[0] : ends[1] + 1])
            span = float(columns[ends[0]]), float(columns[ends[1]])
            brackets.append(Bracket(int(count), cost, span, window, owner))
    return brackets


def _by_column(surveyed: Survey, costs: Array, count: int) -> tuple[Array, Array]:
    """Return the lowest cost among the edges with a count in each column, and the stroke (m) of that edge.

    In a column without such an edge, the cost is infinite and the stroke NaN.
    """
    columns, points = surveyed.columns, surveyed.points
    rows = np.flatnonzero(points.count == count)
    rows = rows[np.argsort(-costs[rows], kind="stable")]  # The lowest cost is written last.
    place = np.searchsorted(columns, points.frequency[rows])
    lowest_cost, strokes = np.full(columns.size, np.inf), np.full(columns.size, np.nan)
    lowest_cost[place], strokes[place] = costs[rows], points.stroke[rows]
    return lowest_cost, strokes


def _window(strokes: Array, least: float = _LEAST_WINDOW) -> tuple[float, float]:
    """Return a window (m) around strokes in which an edge is searched.

    It extends beyond the strokes on both sides by their range, but at least by ``least`` (m).
    """
    low, high = float(np.nanmin(strokes)), float(np.nanmax(strokes))
    reach = max(high - low, least)
    return low - reach, high + reach


def _ends(surveyed: Survey) -> list[Bracket]:
    """Return a bracket around the highest frequency of each branch on the front that ends between two columns."""
    columns, front = surveyed.columns, front_of(surveyed.points)
    brackets = []
    for count in np.unique(front.count):
        _, strokes = _by_column(surveyed, surveyed.points.stroke, int(count))
        present = np.isfinite(strokes)
        for place in np.flatnonzero(present[:-1] & ~present[1:]):
            span = float(columns[place]), float(columns[place + 1])
            window = _window(strokes[max(place - 1, 0) : place + 1])
            brackets.append(Bracket(int(count), speed_cost, span, window))
    return brackets


def minimise(find: FindEdges, brackets: Sequence[Bracket], zoom: Zoom) -> Points:
    """Minimise the costs of all brackets at once. Return the best gait of each bracket that contains one, in order."""
    best, known = followed(find, brackets, zoom)
    return best.take(known)


def followed(find: FindEdges, brackets: Sequence[Bracket], zoom: Zoom) -> tuple[Points, Mask]:
    """Like `minimise`, but return one row for each bracket, and a mask that is True for brackets with a gait."""
    frequency = np.array([bracket.frequency for bracket in brackets]).reshape(-1, 2)
    stroke = np.array([bracket.stroke for bracket in brackets]).reshape(-1, 2)
    rows = np.arange(len(brackets))
    best, lowest_cost = _nothing(len(brackets)), np.full(len(brackets), np.inf)
    for _ in range(zoom.rounds):
        at = np.linspace(frequency[:, 0], frequency[:, 1], zoom.points, axis=1)
        points, costs = _costs(find, brackets, at, stroke)
        place = np.argmin(costs, axis=1)
        cost = costs[rows, place]
        better = cost < lowest_cost
        lowest_cost = np.where(better, cost, lowest_cost)
        best = _where(better, points.take(rows * zoom.points + place), best)
        ends = np.clip(np.stack([place - 1, place + 1], axis=1), 0, zoom.points - 1)
        frequency = np.take_along_axis(at, ends, axis=1)
        strokes = points.stroke.reshape(at.shape)
        for row in np.flatnonzero(np.isfinite(cost)):
            stroke[row] = _window(strokes[row, ends[row, 0] : ends[row, 1] + 1])
    return best, np.isfinite(lowest_cost)


def _costs(
    find: FindEdges, brackets: Sequence[Bracket], at: Array, window: Array
) -> tuple[Points, Array]:
    """Evaluate the cheapest edge of each bracket's count at frequencies ``at`` (brackets, n) in Hz.

    Returns:
        The gaits, one row for each element of ``at`` in C order, and their costs (brackets, n). Without an edge, the
        values of a gait are NaN and its cost is infinite.
    """
    owner = np.repeat(np.arange(len(brackets)), at.shape[1])
    scan = np.linspace(window[owner, 0], window[owner, 1], _WINDOW_SCAN, axis=1)
    counts = np.array([bracket.count for bracket in brackets], dtype=np.int64)
    edges = find(owner, counts[owner], at.ravel(), scan)
    mine = edges.points.count == counts[owner[edges.column]]
    column, points = edges.column[mine], edges.points.take(mine)
    costs = np.full(len(points), np.inf)
    for cost in {bracket.cost for bracket in brackets}:
        rows = np.array([bracket.cost is cost for bracket in brackets])[owner[column]]
        costs[rows] = cost(points.take(rows))
    order = np.argsort(-costs, kind="stable")  # The lowest cost is written last.
    place = np.full(at.size, -1)
    place[column[order]] = order
    table = np.full(at.size, np.inf)
    table[column[order]] = costs[order]
    return Points.join(points, _nothing(1)).take(place), table.reshape(at.shape)


def _nothing(count: int) -> Points:
    unknown = np.full(count, np.nan)
    return Points(unknown, unknown, unknown, unknown, np.zeros(count, np.int64), np.ones(count))


def _where(condition: Mask, first: Points, second: Points) -> Points:
    """Return the rows of ``first`` where the condition is True, and those of ``second`` elsewhere."""
    count = len(second)
    return Points.join(first, second).take(
        np.where(condition, np.arange(count), np.arange(count) + count)
    )


@dataclass(frozen=True)
class ExactFront:
    """Exact front of a task, with the survey for further requests.

    Attributes:
        task: task.
        resolution: resolution of the survey.
        zoom: refinement of minima.
        surveyed: edges at the columns.
        front: non-dominated edges, by rising speed. The gaits of lowest power, lowest cost of transport and highest
            speed are located continuously in the frequency.
        minima: gaits of lowest power and of lowest cost of transport along the edges, as `lowest` returns them.
        power_rises: True if no tried longer stroke on a branch of the front needs less power than the edge. If one
            does, it replaces the edge in the front.
    """

    task: Task
    resolution: Resolution
    zoom: Zoom
    surveyed: Survey
    front: Points
    minima: Points
    power_rises: bool

    def cheapest(self, cost: Cost) -> Points:
        """Minimise a cost over all edges, continuously in the frequency. Return one row; none if no gait qualifies."""
        found = self.minima
        if cost not in _MINIMISED:
            found = lowest(self.task, self.surveyed, [cost], self.zoom)
        candidates = Points.join(self.surveyed.points, self.front, found)
        costs = cost(candidates)
        qualified = np.flatnonzero(np.isfinite(costs))
        return candidates.take(qualified[np.argsort(costs[qualified], kind="stable")[:1]])


def exact_front(task: Task, resolution: Resolution, zoom: Zoom) -> ExactFront:
    """Compute the exact front of a task. The front is empty if no gait of the box is admissible."""
    surveyed = survey(task, resolution, zoom)
    best = lowest(task, surveyed, _MINIMISED, zoom)
    front = front_of(Points.join(surveyed.points, best))
    box = task.bounds
    reach = 0.25 * (box.stroke_high - box.stroke_low) / (resolution.strokes - 1)
    front = front_of(Points.join(front, _rivals(task, surveyed, front, reach)))
    cheaper = _cheaper(task, front)
    front = front_of(Points.join(front, cheaper)) if len(cheaper) else front
    return ExactFront(task, resolution, zoom, surveyed, front, best, not len(cheaper))


def _rivals(task: Task, surveyed: Survey, front: Points, reach: float) -> Points:
    """Return edges of other branches that are as fast as a gait of the front, but need less power.

    Such an edge may lie between two columns. It is searched near the strokes of the edges in these columns, up to a
    distance of at least ``reach`` (m).
    """
    if surveyed.columns.size < 2:
        return front.take(np.empty(0, dtype=np.int64))
    columns, rows = surveyed.columns, []
    counts, frequencies, windows = [], [], []
    for count in np.unique(surveyed.points.count):
        power, strokes = _by_column(surveyed, surveyed.points.power, int(count))
        at = front.count * front.frequency / count * (1.0 + _FASTER)
        place = np.clip(np.searchsorted(columns, at), 1, columns.size - 1)
        near = (front.count != count) & (at >= columns[0]) & (at <= columns[-1])
        cheapest = np.minimum(power[place - 1], power[place])  # Infinite without an edge.
        for row in np.flatnonzero(near & (cheapest < front.power * (1.0 + _NEAR_BEST))):
            rows.append(row)
            counts.append(int(count))
            frequencies.append(at[row])
            windows.append(_window(strokes[place[row] - 1 : place[row] + 1], reach))
    if not rows:
        return front.take(np.empty(0, dtype=np.int64))
    low, high = np.array(windows).T
    scan = np.linspace(low, high, _WINDOW_SCAN, axis=1)
    edges = task.edges(np.array(frequencies), scan, np.array(counts))
    own = front.power[np.array(rows)[edges.column]]
    return edges.points.take(edges.points.power < own)


def _cheaper(task: Task, front: Points) -> Points:
    """Return gaits that differ from a gait of the front by a longer stroke on the same branch, but need less power."""
    shares = np.arange(1, _LONGER + 1)[:, np.newaxis] / _LONGER
    spare = task.bounds.stroke_high - front.shape["pretension"] - front.stroke
    strokes = front.stroke + shares**2 * np.maximum(spare, 0.0)
    shapes = np.tile(front.shape, _LONGER)
    tried = task.points(strokes.ravel(), np.tile(front.frequency, _LONGER), shapes)
    same = tried.admissible & (tried.count == np.tile(front.count, _LONGER))
    return tried.take(same & (tried.power < np.tile(front.power, _LONGER)))
