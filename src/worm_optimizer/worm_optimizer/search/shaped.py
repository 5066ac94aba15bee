# SPDX-License-Identifier: Apache-2.0
"""Edges of shaped gaits, minimised over pretension, contraction share, profile and ramp share.

"Shares" are the contraction share and the ramp share. At some frequencies, the shares of the cheapest corner of each
branch (see `corners`) are searched from several starts. Between these frequencies, the shares are interpolated and the
corner is located again. This is accurate, because near a minimum the power hardly depends on the shares. Near a limit
of the hardware, the power does depend on them. There the contraction share is searched again.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from worm_model.gait import AVERAGED, Profile
from worm_model.parameters import Parameters
from worm_optimizer.evaluation.actuator_limits import NO_LIMITS
from worm_optimizer.evaluation.command_shape import SINUSOID, Shapes
from worm_optimizer.evaluation.task import (
    Array,
    Bounds,
    Edges,
    Index,
    MarginTask,
    Mask,
    Points,
)
from worm_optimizer.search import corners
from worm_optimizer.search.pattern_search import (
    FORBIDDEN,
    LEAST_STEP,
    Costs,
    costs_of,
    improve,
)

_FREQUENCIES = 13  # number of frequencies at which shares are searched
_FREQUENCIES_OF_NODES = 9  # the same number if shares are searched at several margins
_NODES = 5  # number of margins of a scan at which shares are searched (nodes)
# If a branch is lost between two nodes, its shares change quickly there. It then gets further nodes between the last
# node with the branch (position 1) and the largest margin with the branch (position 0), at these positions.
_CLIFF_NODES = (0.5, 0.2, 0.05, 0.0)
_START_SHARES = (0.35, 0.5, 0.65, 0.8)  # contraction shares from which the search starts
_START_RAMPS = (0.1, 0.25, 0.5)  # ramp shares of a trapezoid from which the search starts
# All steps are relative to `pattern_search._FIRST_STEPS`. The first search ends at this step, because near a minimum
# the power hardly changes.
_LEAST_FIRST_STEP = 0.04
_SMALL_STEP = 0.25  # first step of the search from a neighbouring frequency
_LIMIT_STEPS = (0.1, 0.02)  # steps of the two searches for the contraction share at a limit
# The second of these searches includes only gaits beyond a limit, and gaits whose relative distance from the limit is
# between _AT_LIMIT and _NEAR_LIMIT.
_NEAR_LIMIT, _AT_LIMIT = 0.1, 3e-4
_APART = 0.03  # minima with a share that differs by more than this are treated as different minima
_ENDING = 10  # number of bisections of the highest frequency of a branch
_ENDING_SHARES = 6  # number of contraction shares that are tried in each of these bisections
# Positions of further frequencies between the third-last (0) and the last one (1) of a branch
_END_PARTS = (0.2, 0.4, 0.6, 0.8, 0.9)
_CLIFF_HALVINGS = 7  # number of bisections of the largest margin of a branch between two nodes


@dataclass(frozen=True)
class Track:
    """Shares of the cheapest corners of a branch as functions of the frequency, at one margin and with one profile.

    Attributes:
        margin: margin, m.
        count: grooves gained in all averaged cycles together, which identifies the branch.
        profile: profile, as the number in `Profile`.
        frequency: frequencies in Hz, rising, shape (n,).
        shares: contraction share and ramp share, shape (n, 2).
    """

    margin: float
    count: int
    profile: float
    frequency: Array
    shares: Array

    def shares_at(self, frequency: Array) -> Array:
        """Return the interpolated shares (m, 2) at frequencies (m,) in Hz; NaN beyond the track."""
        columns = [
            np.interp(frequency, self.frequency, column, left=np.nan, right=np.nan)
            for column in self.shares.T
        ]
        return np.column_stack(columns)


@dataclass(frozen=True)
class ShapedTask:
    """Extension of a `MarginTask` to shaped gaits. Each edge has the shape that needs the least power.

    Attributes:
        task: task of the sinusoids. The largest stroke of its bounds limits the reach (stroke plus pretension).
        shapes: bounds of the shapes.
        nodes: rising margins in m at which shares are searched. Further nodes are added near the margin at which a
            branch is lost. Shares at other margins are interpolated. Without nodes, shares are searched at the margin
            of ``task``.
    """

    task: MarginTask
    shapes: corners.ShapeBounds
    nodes: tuple[float, ...] = ()

    @property
    def bounds(self) -> Bounds:
        """Box of gaits."""
        return self.task.bounds

    @property
    def parameters(self) -> Parameters:
        """Parameters of the robot."""
        return self.task.parameters

    @property
    def direction(self) -> int:
        """Direction of the gaits."""
        return self.task.direction

    @staticmethod
    def over_margins(task: MarginTask, shapes: corners.ShapeBounds, margins: Array) -> ShapedTask:
        """Return a task that finds edges at any margin within the range of ``margins`` (n,) in m."""
        nodes = np.unique(np.linspace(margins.min(), margins.max(), _NODES))
        return ShapedTask(task, shapes, tuple(nodes.tolist()))

    def points(self, stroke: ArrayLike, frequency: ArrayLike, shape: Shapes = SINUSOID) -> Points:
        """Return the evaluated gaits, see `Task`."""
        return self.task.points(stroke, frequency, shape)

    def edges(
        self,
        frequency: Array,
        strokes: Array,
        count: Index | None = None,
        margin: Array | None = None,
    ) -> Edges:
        """Find the corners of all branches at each frequency, and the edges of the sinusoid if the bounds permit it.

        See `Task`. ``strokes`` are used only for the sinusoid. ``margin`` contains the margin of each column in m,
        within the range of the nodes. None uses the margin of the task.
        """
        margins = np.full(frequency.shape, self.task.margin) if margin is None else margin
        parts = list(self._candidates(frequency, margins, count))
        column = np.concatenate([rows for rows, _, _ in parts])
        problems = corners.Columns.join(*(columns for _, columns, _ in parts))
        shares = np.concatenate([tried for _, _, tried in parts])
        shares = _Search(self.task, self.shapes).within_limits(problems, shares)
        points, gains = corners.corners(self.task, self.shapes, problems, shares, corners.FINE)
        kept = gains & points.admissible
        found = [Edges(column[kept], points.take(kept))]
        if self.shapes.include_sinusoid:
            found.append(self.task.edges(frequency, strokes, count, margins))
        column = np.concatenate([part.column for part in found])
        return Edges(column, Points.join(*(part.points for part in found)))

    def _candidates(
        self, frequency: Array, margin: Array, count: Index | None
    ) -> Iterator[tuple[Index, corners.Columns, Array]]:
        """Yield the shares to be tried at each frequency.

        ``count`` contains the branch that is needed at each frequency. None yields the shares of all branches.

        Each element is (index of the column (n,), problems (n,), shares (n, 2)).
        """
        yield np.empty(0, dtype=np.int64), corners.NO_COLUMNS, np.empty((0, 2))
        for own, profile in sorted({(track.count, track.profile) for track in self.tracks}):
            wanted = np.ones(frequency.size, dtype=bool) if count is None else count == own
            for shares in self._shares(own, profile, frequency, margin):
                rows = np.flatnonzero(wanted & np.isfinite(shares[:, 0]))
                key = np.full(rows.size, own), np.full(rows.size, profile)
                yield rows, corners.Columns(frequency[rows], margin[rows], *key), shares[rows]

    @cached_property
    def tracks(self) -> tuple[Track, ...]:
        """Tracks of all branches."""
        count = _FREQUENCIES_OF_NODES if len(self.nodes) > 1 else _FREQUENCIES
        box = self.bounds
        frequencies = np.unique(np.linspace(box.frequency_low, box.frequency_high, count))
        margins = np.array(self.nodes or (self.task.margin,))
        return tuple(tracks_of(self.task, self.shapes, margins, frequencies))

    def _shares(
        self, count: int, profile: float, frequency: Array, margin: Array
    ) -> tuple[Array, Array, Array]:
        """Return three arrays of shares (m, 2) of a branch to be tried, NaN beyond its tracks.

        The first array is interpolated between the nodes below and above each margin. The other two arrays are needed
        if the shares at these nodes belong to different minima, because a gait between two minima needs more power.
        They then contain the shares at the node below and at the node above, and NaN otherwise.
        """
        searched = [track.margin for track in self.tracks]
        nodes = np.union1d(self.nodes or (self.task.margin,), searched)
        table = np.full((nodes.size, frequency.size, 2), np.nan)
        for track in self.tracks:
            if (track.count, track.profile) == (count, profile):
                table[np.searchsorted(nodes, track.margin)] = track.shares_at(frequency)
        above = np.clip(np.searchsorted(nodes, margin), 0, nodes.size - 1)
        below = np.maximum(above - 1, 0)
        columns = np.arange(frequency.size)
        low, high = table[below, columns], table[above, columns]
        with np.errstate(invalid="ignore"):
            part = (margin - nodes[below]) / np.where(
                above > below, nodes[above] - nodes[below], 1.0
            )
        part = part[:, np.newaxis]
        mixed = (1.0 - part) * low + part * high
        shares = np.where(np.isnan(mixed), np.where(np.isnan(high), low, high), mixed)
        # If the shares at both nodes are at a bound, rounding may place the interpolated share beyond it.
        shares = np.clip(shares, *self.shapes.shares.T)
        apart = np.any(np.abs(high - low) > _APART, axis=1, keepdims=True)
        return shares, np.where(apart, low, np.nan), np.where(apart, high, np.nan)


@dataclass(frozen=True)
class Solved:
    """Problems, ``shares`` (n, 2) of their cheapest corners found so far, and ``cost`` (n,) in W, see `Costs.total`."""

    columns: corners.Columns
    shares: Array
    cost: Array

    def take(self, rows: Index | Mask) -> Solved:
        """Return the rows (integers or a mask)."""
        return Solved(self.columns.take(rows), self.shares[rows], self.cost[rows])

    @staticmethod
    def join(*parts: Solved) -> Solved:
        """Return the rows of all parts, in order."""
        return Solved(
            corners.Columns.join(*(part.columns for part in parts)),
            np.concatenate([part.shares for part in parts]),
            np.concatenate([part.cost for part in parts]),
        )

    def best(self) -> Solved:
        """Return the cheapest row of each problem, sorted by margin, count, profile and frequency."""
        own = self.columns
        keys = np.stack([own.frequency, own.profile, own.count, own.margin])
        order = np.lexsort((self.cost, *keys))
        first = np.ones(order.size, dtype=bool)
        first[1:] = np.any(np.diff(keys[:, order], axis=1) != 0.0, axis=0)
        return self.take(order[first])

    def groups(self) -> Iterator[Solved]:
        """Yield the rows of each margin, count and profile. The rows must be sorted as by `best`."""
        own = self.columns
        keys = np.stack([own.profile, own.count, own.margin])
        borders = np.flatnonzero(np.any(np.diff(keys, axis=1) != 0.0, axis=0)) + 1
        for rows in np.split(np.arange(self.cost.size), borders):
            if rows.size:
                yield self.take(rows)

    def track(self) -> Track:
        """Return the rows of one group as a track."""
        own = self.columns
        key = float(own.margin[0]), int(own.count[0]), float(own.profile[0])
        return Track(*key, own.frequency, self.shares)

    def interpolated(self, frequency: Array) -> tuple[corners.Columns, Array]:
        """Return the problems of one group at other frequencies (m,) in Hz, with interpolated shares (m, 2)."""
        rows = np.zeros(frequency.size, dtype=np.int64)
        columns = dataclasses.replace(self.columns.take(rows), frequency=frequency)
        return columns, self.track().shares_at(frequency)


@dataclass(frozen=True)
class _Search:
    """Search for the cheapest shares of many problems."""

    task: MarginTask
    shapes: corners.ShapeBounds

    def costs(self, columns: corners.Columns, shares: Array) -> Costs:
        """Return the costs of the corners."""
        return costs_of(*corners.corners(self.task, self.shapes, columns, shares, corners.COARSE))

    def improved(
        self, columns: corners.Columns, shares: Array, step: float, least: float = LEAST_STEP
    ) -> Solved:
        """Search for cheaper shares from given ones. ``step`` and ``least`` are the first and last relative step."""
        found, costs = self._improved(columns, columns.has_ramps, shares, (step, least))
        return Solved(columns, found, costs.total)

    def within_limits(self, columns: corners.Columns, shares: Array) -> Array:
        """Search the contraction shares again if the task has limits of the actuators, and return all shares."""
        if self.task.limits == NO_LIMITS:
            return shares
        moved, rows = shares.copy(), np.arange(len(shares))
        for step in _LIMIT_STEPS:
            fixed = np.zeros(rows.size, dtype=bool)
            own = columns.take(rows)
            moved[rows], costs = self._improved(own, fixed, moved[rows], (step, step))
            spare = -costs.violation
            rows = rows[(spare < 0.0) | ((spare > _AT_LIMIT) & (spare < _NEAR_LIMIT))]
        return moved

    def _improved(
        self, columns: corners.Columns, has_ramps: Mask, shares: Array, steps: tuple[float, float]
    ) -> tuple[Array, Costs]:
        def cost_of(rows: Index, tried: Array) -> Costs:
            return self.costs(columns.take(rows), tried)

        return improve(cost_of, has_ramps, self.shapes.shares, shares, steps)

    def solved(self, margins: Array, frequencies: Array) -> Solved:
        """Search the cheapest shares of all branches at margins in m and frequencies in Hz, both rising.

        The shares at the highest frequency of each branch are searched, too.
        """
        known = self.begun(margins, frequencies).best()
        known = Solved.join(known, self.continued(known)).best()
        known = known.take(known.cost < FORBIDDEN)
        known = Solved.join(known, self.ended(known, float(frequencies[-1]))).best()
        known = self.filled(known, frequencies).best()
        return known.take(known.cost < FORBIDDEN)

    def begun(self, margins: Array, frequencies: Array) -> Solved:
        """Search the shares of each branch, starting from the cheapest start shares that reach this branch."""
        columns, starts, gained = self._started(margins, frequencies)
        wanted = [
            np.flatnonzero(gained >= count)
            for count in range(AVERAGED, int(gained.max(initial=0)) + 1, AVERAGED)
        ]
        count = np.repeat(AVERAGED * np.arange(1, len(wanted) + 1), [len(w) for w in wanted])
        rows = np.concatenate([np.empty(0, dtype=np.int64), *wanted])
        columns = dataclasses.replace(columns.take(rows), count=count)
        shares = starts[rows]
        best = Solved(columns, shares, self.costs(columns, shares).total).best()
        best = best.take(np.isfinite(best.cost))
        return self.improved(best.columns, best.shares, 1.0, _LEAST_FIRST_STEP)

    def _started(self, margins: Array, frequencies: Array) -> tuple[corners.Columns, Array, Index]:
        """Return one row for each margin, frequency and start: problems, shares (n, 2), and grooves gained (n,)."""
        starts = np.array(
            [
                (profile, share, ramp)
                for profile, ramps in (
                    (Profile.TRAPEZOID, _START_RAMPS),
                    (Profile.COSINE, _START_RAMPS[:1]),
                )
                for share, ramp in itertools.product(_START_SHARES, ramps)
            ]
        )
        starts[:, 1:] = np.clip(starts[:, 1:], *self.shapes.shares.T)
        numbers = np.arange(len(starts), dtype=float)
        margin, frequency, start = (
            axis.ravel() for axis in np.meshgrid(margins, frequencies, numbers, indexing="ij")
        )
        profile, shares = starts[start.astype(np.int64), 0], starts[start.astype(np.int64), 1:]
        columns = corners.Columns(frequency, margin, np.ones(margin.size, np.int64), profile)
        return columns, shares, corners.most_gained(self.task, self.shapes, columns, shares)

    def continued(self, known: Solved) -> Solved:
        """Search again from the shares of a neighbouring frequency if they are cheaper here than the known shares."""
        parts = []
        for group in known.groups():
            places = np.arange(group.cost.size)
            for at, near in ((places[1:], places[:-1]), (places[:-1], places[1:])):
                own = group.take(at)
                parts.append(Solved(own.columns, group.shares[near], own.cost))
        tried = Solved.join(*parts) if parts else known
        costs = self.costs(tried.columns, tried.shares).total
        better = costs < tried.cost * (1.0 - 1e-6)
        return self.improved(tried.columns.take(better), tried.shares[better], _SMALL_STEP)

    def ended(self, known: Solved, highest: float) -> Solved:
        """Search the highest frequency of each branch that ends below ``highest`` (Hz), and the shares there."""
        lasts = [group.take(np.array([-1])) for group in known.groups()]
        lasts = [last for last in lasts if last.columns.frequency[0] < highest]
        if not lasts:
            return known
        good = Solved.join(*lasts)
        bad = np.full(good.cost.size, highest)
        for _ in range(_ENDING):
            middle = 0.5 * (good.columns.frequency + bad)
            columns = dataclasses.replace(good.columns, frequency=middle)
            tried = self._cheapest_share(columns, good.shares)
            if self.task.limits != NO_LIMITS:
                near = self.improved(columns, good.shares, _SMALL_STEP, _SMALL_STEP)
                tried = Solved.join(tried, near).best()
            keeps = tried.cost < FORBIDDEN
            rows = np.arange(keeps.size)
            good = Solved.join(good, tried).take(np.where(keeps, rows + keeps.size, rows))
            bad = np.where(keeps, bad, middle)
        return self.improved(good.columns, good.shares, _SMALL_STEP)

    def _cheapest_share(self, columns: corners.Columns, shares: Array) -> Solved:
        """Return the cheapest of some contraction shares from the least to the given one, with the least ramp share."""
        least = self.shapes.shares[:, 0]
        parts = []
        for part in np.linspace(0.0, 1.0, _ENDING_SHARES):
            tried = (
                np.column_stack([part * (shares[:, 0] - least[0]), np.zeros(len(shares))]) + least
            )
            parts.append(Solved(columns, tried, self.costs(columns, tried).total))
        return Solved.join(*parts).best()

    def filled(self, known: Solved, frequencies: Array) -> Solved:
        """Add ``frequencies`` (Hz) that a branch lacks between two of its own, starting from interpolated shares."""
        parts = []
        for group in known.groups():
            own = group.columns.frequency
            lacking = np.setdiff1d(
                frequencies[(frequencies > own[0]) & (frequencies < own[-1])], own
            )
            parts.append(group.interpolated(lacking))
        return Solved.join(known, self._improved_together(parts))

    def with_ends(self, known: Solved, highest: float) -> Solved:
        """Add frequencies just below the highest one of each branch, where the shares change quickly."""
        parts = []
        for group in known.groups():
            own = group.columns.frequency
            if own.size < 3 or own[-1] == highest:
                continue
            frequency = own[-3] + (own[-1] - own[-3]) * np.array(_END_PARTS)
            parts.append(group.interpolated(frequency))
        best = Solved.join(known, self._improved_together(parts)).best()
        return best.take(best.cost < FORBIDDEN)

    def _improved_together(self, parts: list[tuple[corners.Columns, Array]]) -> Solved:
        """Search from the shares (n, 2) of all parts at the same time, with small steps."""
        columns = corners.Columns.join(corners.NO_COLUMNS, *(columns for columns, _ in parts))
        shares = np.concatenate([np.empty((0, 2)), *(shares for _, shares in parts)])
        return self.improved(columns, shares, _SMALL_STEP)

    def cliff_nodes(self, known: Solved, margins: Array) -> Array:
        """Return further margins in m for branches that are lost between two of ``margins`` (m, rising)."""
        own, further = known.columns, [np.empty(0)]
        for count in np.unique(own.count):
            last = own.margin[own.count == count].max()
            if last == margins[-1]:
                continue
            frequencies = np.unique(own.frequency[(own.count == count) & (own.margin == last)])
            kept, lost = float(last), float(margins[margins > last][0])
            for _ in range(_CLIFF_HALVINGS):
                middle = 0.5 * (kept + lost)
                _, _, gained = self._started(np.array([middle]), frequencies)
                kept, lost = (middle, lost) if gained.max() >= count else (kept, middle)
            further.append(kept - (kept - last) * np.array(_CLIFF_NODES))
        return np.setdiff1d(np.concatenate(further), margins)


def tracks_of(
    task: MarginTask, shapes: corners.ShapeBounds, margins: Array, frequencies: Array
) -> list[Track]:
    """Search the cheapest shares of all branches at ``margins`` in m and ``frequencies`` in Hz, both rising.

    If a branch is lost between two margins, shares are also searched at some margins just before it is lost.
    """
    search = _Search(task, shapes)
    known = search.solved(margins, frequencies)
    if margins.size == 1:
        known = search.with_ends(known, float(frequencies[-1]))
    further = search.cliff_nodes(known, margins)
    if further.size:
        known = Solved.join(known, search.solved(further, frequencies))
    return [group.track() for group in known.groups()]
