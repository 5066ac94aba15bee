# SPDX-License-Identifier: Apache-2.0
"""Gaits that keep their grooves with a given probability, and the largest margin that a gait tolerates.

A gait keeps a number of grooves in a scenario if it gains at least this number in every averaged cycle. Its promise is
the largest number of grooves per cycle that it keeps with the given probability. The paper enlarges the switching
threshold to stay away from the edges of a branch. Here the edges follow from the uncertainty itself: the edge of a
promise is the shortest stroke with which the gait keeps the promise in enough scenarios. The scenarios are the same at
every stroke (common random numbers). If they cover all groove phases and the probability is 1, the gaits keep their
grooves at any phase.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from worm_model.errors import InputError
from worm_model.gait import AVERAGED
from worm_model.margin.predicted_margin import largest_margins
from worm_optimizer.evaluation.command_shape import SINUSOID, Shapes
from worm_optimizer.evaluation.task import (
    EDGE_ALLOWANCE,
    EDGE_TOLERANCE,
    Array,
    Bounds,
    Edges,
    Index,
    MarginTask,
    Mask,
    Points,
)
from worm_optimizer.robustness.prediction import grooves_in
from worm_optimizer.robustness.uncertainty import Scenarios

# Returns the grooves (n,) gained in the worst averaged cycle. Arguments: strokes in m, indices of gaits, and indices of
# scenarios, (n,) each.
_Gained = Callable[[Array, Index, Index], Index]


@dataclass(frozen=True)
class PromiseTask:
    """Task of eq:moo_formulation that counts the promise of a gait instead of the grooves it gains with a margin.

    A gait's promise is the largest number of grooves per cycle that it keeps in a share of at least ``probability`` of
    the ``scenarios``. The speed of the gait is promise · d · f, and its power is that of the nominal robot. The margin
    of ``task``, usually 0, applies in all scenarios. Raises `InputError` unless 0 < probability ≤ 1.
    """

    task: MarginTask
    scenarios: Scenarios
    probability: float

    def __post_init__(self) -> None:
        if not 0.0 < self.probability <= 1.0:
            raise InputError(f"probability: must be above 0 and at most 1, not {self.probability}")

    @property
    def bounds(self) -> Bounds:
        """Box of gaits."""
        return self.task.bounds

    def points(self, stroke: ArrayLike, frequency: ArrayLike, shape: Shapes = SINUSOID) -> Points:
        """Return gaits evaluated by their promises, see `Task`."""
        points = self.task.with_margin(0.0).points(stroke, frequency, shape)
        promise = self._promise(
            grooves_in(self.task, points.stroke, points.frequency, self.scenarios, points.shape)
        )
        speed = promise * self.task.parameters.pitch * points.frequency
        violation = np.where(promise >= 1, points.violation, 1.0)
        return Points(
            points.stroke,
            points.frequency,
            speed,
            points.power,
            AVERAGED * promise,
            violation,
            points.shape,
        )

    def edges(self, frequency: Array, strokes: Array, count: Index | None = None) -> Edges:
        """Find the shortest stroke that keeps each promise at each frequency, see `Task`.

        The search assumes that a longer stroke never gains fewer grooves in a scenario. The gaits found are then
        evaluated in all scenarios, and only the gaits that keep their promise are returned.
        """
        low, high = (
            np.clip(strokes[:, end], self.bounds.stroke_low, self.bounds.stroke_high)
            for end in (0, -1)
        )
        at_low, at_high = (
            grooves_in(self.task, ends, frequency, self.scenarios) for ends in (low, high)
        )
        most = self._promise(at_high)
        column, promise = np.nonzero(np.arange(1, most.max(initial=0) + 1) <= most[:, np.newaxis])
        promise += 1
        brackets = _Brackets.between(
            low[column], high[column], promise, at_low[column], at_high[column], self._required
        )
        while brackets.width > EDGE_TOLERANCE:
            brackets.halve(self._gained_at(frequency[column]))
        safe = np.minimum(brackets.high + EDGE_ALLOWANCE * brackets.stepped, high[column])
        found = self.points(safe, frequency[column])
        is_edge = found.admissible & (found.count >= AVERAGED * promise)
        if count is not None:
            is_edge &= found.count == count[column]
        return Edges(column[is_edge], found.take(is_edge))

    @property
    def _required(self) -> int:
        """Number of scenarios in which a promise must be kept."""
        return len(self.scenarios) - self._spared

    @property
    def _spared(self) -> int:
        """Largest number of scenarios in which a promise may fail."""
        spared = math.floor((1.0 - self.probability) * len(self.scenarios) + 1e-9)
        return min(spared, len(self.scenarios) - 1)

    def _gained_at(self, frequency: Array) -> _Gained:
        """Return a `_Gained` function for gaits with the frequencies ``frequency`` (Hz)."""

        def gained(stroke: Array, row: Index, scenario: Index) -> Index:
            overrides = {key: values[scenario] for key, values in self.scenarios.overrides.items()}
            return self.task.grooves(stroke, frequency[row], overrides=overrides)

        return gained

    def _promise(self, gained: Index) -> Index:
        """Return the largest number of grooves kept in enough scenarios, from the numbers ``gained`` (n, scenarios)."""
        return np.maximum(np.sort(gained, axis=1)[:, self._spared], 0)


@dataclass
class _Brackets:
    """Brackets of the shortest strokes that keep promises.

    A stroke is evaluated only in the scenarios whose result does not follow from strokes that were evaluated before.

    Attributes:
        low, high: ends of the brackets in m, shape (n,).
        promise: grooves per cycle to be kept, shape (n,).
        fails: longest stroke in m that is known to fail the promise in a scenario, shape (n, scenarios).
        keeps: shortest stroke in m that is known to keep the promise in a scenario, shape (n, scenarios).
        required: number of scenarios in which a promise must be kept.
        stepped: True if the promise is not kept at the initial ``low``, shape (n,).
    """

    low: Array
    high: Array
    promise: Index
    fails: Array
    keeps: Array
    required: int
    stepped: Mask

    @staticmethod
    def between(
        low: Array, high: Array, promise: Index, at_low: Index, at_high: Index, required: int
    ) -> _Brackets:
        """Return the initial brackets.

        ``at_low`` and ``at_high`` are the grooves gained at their ends, shape (n, scenarios).
        """
        keeps_low, keeps_high = (gained >= promise[:, np.newaxis] for gained in (at_low, at_high))
        columns = low[:, np.newaxis], high[:, np.newaxis]
        keeps = np.where(keeps_low, columns[0], np.where(keeps_high, columns[1], np.inf))
        fails = np.where(keeps_low, -np.inf, np.where(keeps_high, columns[0], np.inf))
        stepped = keeps_low.sum(axis=1) < required
        return _Brackets(
            low, np.where(stepped, high, low), promise, fails, keeps, required, stepped
        )

    @property
    def width(self) -> float:
        """Width of the widest bracket in m."""
        return float((self.high - self.low).max(initial=0.0))

    def halve(self, gained: _Gained) -> None:
        """Halve every bracket."""
        middle = 0.5 * (self.low + self.high)
        across = middle[:, np.newaxis]
        row, scenario = np.nonzero((self.fails < across) & (across < self.keeps))
        kept = gained(middle[row], row, scenario) >= self.promise[row]
        self.keeps[row[kept], scenario[kept]] = middle[row[kept]]
        self.fails[row[~kept], scenario[~kept]] = middle[row[~kept]]
        suffices = np.sum(self.keeps <= across, axis=1) >= self.required
        self.low = np.where(suffices, self.low, middle)
        self.high = np.where(suffices, middle, self.high)


def tolerated_margins(task: MarginTask, front: Points) -> Array:
    """Return the largest margin in m up to which each gait of a front gains its grooves, shape (n,).

    Margins above 20 mm are not searched. The result is 0 for a gait with which the nominal robot does not gain its
    grooves.
    """
    promised = front.count[:, np.newaxis] // AVERAGED

    def kept(margins: Array) -> Mask:
        stroke, frequency = (
            np.broadcast_to(values[:, np.newaxis], margins.shape)
            for values in (front.stroke, front.frequency)
        )
        gained = task.grooves(stroke, frequency, margins, shape=front.shape[:, np.newaxis])
        return gained >= promised

    return largest_margins(kept, len(front))
