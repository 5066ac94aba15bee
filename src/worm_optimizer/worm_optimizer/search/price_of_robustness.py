# SPDX-License-Identifier: Apache-2.0
"""Price of robustness: the lowest cost of transport as a function of the margin δ_m, and its cliff.

All margins are scanned at once, on the branches' lower edges (`exact`).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from worm_model.errors import InputError
from worm_model.gait import AVERAGED
from worm_model.simulation import closed_form
from worm_model.simulation.simulator import cost_of_transport
from worm_optimizer.evaluation.task import Array, Edges, Index, MarginTask, Points
from worm_optimizer.search import exact
from worm_optimizer.search.shaped import ShapedTask

CLIFF_RISE = 1.25  # least factor by which the lowest cost of transport rises at a cliff
CLIFF_TOLERANCE = 1e-6  # accuracy of the margin at the cliff, m
CLIFF_RULE = (
    "a cliff lies between two successive margins of the scan if the branch (grooves per cycle) with the lowest cost of "
    f"transport is lost and this cost rises by a factor of {CLIFF_RISE} or more, or if no gait moves any more; the "
    f"margin at the cliff is found by bisection to {1e6 * CLIFF_TOLERANCE:g} µm"
)
# A coarse resolution suffices, because `exact.followed` refines the minimum between these frequencies. 81 margins take
# two seconds.
_RESOLUTION = exact.Resolution(strokes=21, frequencies=17)
_ZOOM = exact.Zoom(points=5, rounds=6)


@dataclass(frozen=True)
class MarginPoint:
    """Gait with the lowest cost of transport at one margin; cost, stroke and frequency are NaN if no gait moves.

    Attributes:
        margin: margin, m.
        cost_of_transport: lowest cost of transport.
        stroke: stroke of this gait, m.
        frequency: frequency of this gait, Hz.
        branch: grooves per cycle of this gait; 0 if no gait moves.
        branches: grooves per cycle of all branches at this margin.
    """

    margin: float
    cost_of_transport: float
    stroke: float
    frequency: float
    branch: float
    branches: tuple[float, ...]


@dataclass(frozen=True)
class Cliff:
    """Cliff of the price of robustness.

    Attributes:
        margin: margin at the cliff, m.
        before, after: neighbouring margins of the scan, m.
        rise: lowest cost of transport at ``after``, relative to that at ``before``; infinite if no gait moves there.
        lost_branch: grooves per cycle of the branch that is lost.
    """

    margin: float
    before: float
    after: float
    rise: float
    lost_branch: float

    @property
    def consequence(self) -> str:
        """Loss of a branch beyond the margin, and the rise of the cost of transport, as text."""
        rise = (
            "no gait moves"
            if math.isinf(self.rise)
            else f"the lowest cost of transport rises by a factor of {self.rise:.2f}"
        )
        return f"the branch with {self.lost_branch:g} grooves per cycle is lost and {rise}"


@dataclass(frozen=True)
class PriceOfRobustness:
    """Result of a margin scan.

    Attributes:
        points: optimum at each margin, by rising margin.
        cliff: cliff; None if the scanned margins contain none.
        closed_form_cliff_margin: margin at which slow gaits, whose viscous friction is negligible, lose the branch with
            two grooves per cycle, m; see `closed_form`.
        groove_phase: groove phase of the robot, m.
    """

    points: tuple[MarginPoint, ...]
    cliff: Cliff | None
    closed_form_cliff_margin: float
    groove_phase: float

    @property
    def moves(self) -> bool:
        """True if a gait moves at any margin."""
        return any(point.branch for point in self.points)

    @property
    def margin(self) -> float:
        """Chosen margin in m: the last scanned margin below the cliff.

        If there is no cliff, it is the largest scanned margin at which a gait moves.

        Raises `InputError` if no gait moves at any margin.
        """
        if not self.moves:
            raise InputError(
                "no gait within the bounds moves at any margin of the scan: "
                "lower the margins, relax the limits or allow longer strokes"
            )
        if self.cliff is not None:
            return self.cliff.before
        return max(point.margin for point in self.points if point.branch)


def price_of_robustness(task: MarginTask | ShapedTask, margins: Array) -> PriceOfRobustness:
    """Scan the rising ``margins`` in m of shape (n,) and locate the cliff."""
    points = scan(task, margins)
    return PriceOfRobustness(
        points=points,
        cliff=find_cliff(task, points),
        closed_form_cliff_margin=closed_form.cliff_margin(task.parameters, task.direction),
        groove_phase=closed_form.groove_phase(task.parameters),
    )


def scan(task: MarginTask | ShapedTask, margins: Array) -> tuple[MarginPoint, ...]:
    """Return the gait with the lowest cost of transport at each of ``margins`` in m of shape (n,)."""
    columns, box = _RESOLUTION.columns(task.bounds), task.bounds
    at = np.repeat(margins, columns.size)
    strokes = np.linspace(box.stroke_low, box.stroke_high, _RESOLUTION.strokes)
    edges = task.edges(np.tile(columns, margins.size), np.tile(strokes, (at.size, 1)), margin=at)
    of_margin = edges.column // columns.size
    found = [edges.points.take(of_margin == place) for place in range(margins.size)]
    brackets = [
        bracket
        for place, points in enumerate(found)
        for bracket in exact.brackets_of(
            exact.Survey(columns, points), exact.transport_cost, owner=place
        )
    ]
    best = _followed(task, brackets, margins)
    optima = [Points.join(*pair) for pair in zip(found, best, strict=True)]
    return tuple(_margin_point(task, *pair) for pair in zip(margins.tolist(), optima, strict=True))


def _followed(
    task: MarginTask | ShapedTask, brackets: Sequence[exact.Bracket], margins: Array
) -> list[Points]:
    """Minimise the cost in each bracket, and return the minima of each margin.

    The field ``owner`` of a bracket is the index of its margin.
    """
    owner = np.array([bracket.owner for bracket in brackets], dtype=np.int64)

    def find(bracket: Index, count: Index, frequency: Array, strokes: Array) -> Edges:
        return task.edges(frequency, strokes, count, margins[owner[bracket]])

    best, known = exact.followed(find, brackets, _ZOOM)
    return [best.take(known & (owner == place)) for place in range(margins.size)]


def _margin_point(task: MarginTask | ShapedTask, margin: float, points: Points) -> MarginPoint:
    if not len(points):
        return MarginPoint(margin, math.nan, math.nan, math.nan, 0.0, ())
    cost = cost_of_transport(points.speed, points.power, task.parameters.mass)
    best = int(np.argmin(cost))
    return MarginPoint(
        margin=margin,
        cost_of_transport=float(cost[best]),
        stroke=float(points.stroke[best]),
        frequency=float(points.frequency[best]),
        branch=float(points.grooves[best]),
        branches=tuple((np.unique(points.count) / AVERAGED).tolist()),
    )


def find_cliff(task: MarginTask | ShapedTask, points: Sequence[MarginPoint]) -> Cliff | None:
    """Locate the cliff of a scan by `CLIFF_RULE`; None if there is none. ``points`` by rising margin."""
    for before, after in itertools.pairwise(points):
        if _is_lost(before, after):
            rise = after.cost_of_transport / before.cost_of_transport if after.branch else math.inf
            margin = _bisected(task, before, after)
            return Cliff(margin, before.margin, after.margin, rise, before.branch)
    return None


def _is_lost(before: MarginPoint, after: MarginPoint) -> bool:
    """Return True if a cliff lies between two margins according to `CLIFF_RULE`."""
    if not before.branch or before.branch in after.branches:
        return False
    return not after.branch or after.cost_of_transport >= CLIFF_RISE * before.cost_of_transport


def _bisected(task: MarginTask | ShapedTask, before: MarginPoint, after: MarginPoint) -> float:
    """Bisect between two scanned margins, and return the largest evaluated margin (m) that is below the cliff."""
    low, high = before.margin, after.margin
    while high - low > CLIFF_TOLERANCE:
        middle = 0.5 * (low + high)
        (point,) = scan(task, np.array([middle]))
        low, high = (low, middle) if _is_lost(before, point) else (middle, high)
    return low
