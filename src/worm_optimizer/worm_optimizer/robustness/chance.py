# SPDX-License-Identifier: Apache-2.0
"""Fronts that promise their grooves with a probability, and the margin that such a promise amounts to.

The paper enlarges a threshold to stay away from the edges of a branch; here the edges come from the
uncertainty itself. With every groove phase as a scenario and probability 1, the gaits are any-phase
gaits: they need no knowledge of φ.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from worm_model.gait import MAX_MARGIN
from worm_optimizer.robustness.success_probability import grooves_in
from worm_optimizer.robustness.uncertainty import Scenarios
from worm_optimizer.search.optimizer_errors import OptimizerError
from worm_optimizer.search.task import Array, Bounds, Index, MarginTask, Mask, Points, Task

_MARGIN_STEP = 2.5e-4  # m, of the first look for the margin that a gait stands
_MOST_MARGIN = 2e-2  # m, where that look ends
_MARGIN_PASSES = 10
_PART = 100  # gaits between two reports of progress: some tenths of a second


@dataclass(frozen=True)
class PromiseTask:
    """eq:moo_formulation with P(n ≥ promised) ≥ ``probability`` over ``scenarios``.

    The task's margin holds in the scenarios too; it is usually 0.

    A gait's promise is the greatest number of grooves per cycle that it keeps with that probability; its
    speed is promise · d · f and its power that of the nominal robot. Raises `OptimizerError` unless
    0 < probability ≤ 1.
    """

    task: MarginTask
    scenarios: Scenarios
    probability: float

    def __post_init__(self) -> None:
        if not 0.0 < self.probability <= 1.0:
            raise OptimizerError(f"probability: {self.probability} is not above 0 and at most 1")

    @property
    def bounds(self) -> Bounds:
        """The box of gaits."""
        return self.task.bounds

    def points(self, stroke: ArrayLike, frequency: ArrayLike) -> Points:
        """Evaluates gaits by what they promise; ``stroke`` in m and ``frequency`` in Hz of shape (n,)."""
        points = self.task.with_margin(0.0).points(stroke, frequency)
        gained = grooves_in(self.task, points.stroke, points.frequency, self.scenarios)
        promise = self._promise(gained)
        speed = promise * self.task.parameters.pitch * points.frequency
        violation = np.where(promise >= 1, points.violation, 1.0)
        return Points(points.stroke, points.frequency, speed, points.power, promise, violation)

    def _promise(self, gained: Index) -> Index:
        """Greatest count kept in the required share of the scenarios, from counts of shape (n, scenarios)."""
        ascending = np.sort(gained, axis=1)
        spared = int(np.floor((1.0 - self.probability) * gained.shape[1] + 1e-9))
        return np.maximum(ascending[:, min(spared, gained.shape[1] - 1)], 0)


# How parts of many gaits, each (stroke in m, frequency in Hz), are evaluated; the results in the order of the parts.
Evaluate = Callable[[Task, Sequence[tuple[Array, Array]]], Iterable[Points]]


def in_turn(task: Task, parts: Sequence[tuple[Array, Array]]) -> Iterable[Points]:
    """One part after the other, here."""
    return (task.points(*part) for part in parts)


@dataclass(frozen=True)
class WatchedTask:
    """A slow task in small parts: ``judged`` gets the number of gaits after each, and may raise to cancel."""

    task: Task
    judged: Callable[[int], None]
    evaluate: Evaluate = in_turn

    @property
    def bounds(self) -> Bounds:
        """The box of gaits."""
        return self.task.bounds

    def points(self, stroke: ArrayLike, frequency: ArrayLike) -> Points:
        """As the task evaluates them; ``stroke`` in m and ``frequency`` in Hz of shape (n,)."""
        strokes, frequencies = np.asarray(stroke, dtype=float), np.asarray(frequency, dtype=float)
        parts = [slice(start, start + _PART) for start in range(0, strokes.size, _PART)]
        judged = [self.task.points(strokes[:0], frequencies[:0])]
        for points in self.evaluate(self.task, [(strokes[p], frequencies[p]) for p in parts]):
            judged.append(points)
            self.judged(len(points))
        return Points.join(*judged)


def margins_stood(task: MarginTask, front: Points) -> Array:
    """The largest margin in m, up to 20 mm, at which each gait of a front still gains what it promises.

    0 for a gait whose promise the nominal robot does not keep. Shape (n,).
    """
    looked = np.arange(0.0, min(_MOST_MARGIN, MAX_MARGIN), _MARGIN_STEP)
    strokes = np.repeat(front.stroke[:, np.newaxis], looked.size, axis=1)
    frequencies = np.repeat(front.frequency[:, np.newaxis], looked.size, axis=1)
    kept = _kept(task, strokes, frequencies, looked, front.branch[:, np.newaxis])
    lost = np.argmin(np.column_stack([kept, np.zeros(len(front), dtype=bool)]), axis=1)
    low = looked[np.maximum(lost - 1, 0)]
    high = low + np.where(lost > 0, _MARGIN_STEP, 0.0)
    for _ in range(_MARGIN_PASSES):
        middle = 0.5 * (low + high)
        stays = _kept(task, front.stroke, front.frequency, middle, front.branch)
        low, high = np.where(stays, middle, low), np.where(stays, high, middle)
    return low


def _kept(
    task: MarginTask, stroke: Array, frequency: Array, margin: Array, promised: Index
) -> Mask:
    return task.grooves(stroke, frequency, margin) >= promised
