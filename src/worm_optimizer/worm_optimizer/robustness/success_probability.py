# SPDX-License-Identifier: Apache-2.0
"""How robust a gait is: its success probability and its distance to the edges of its branch."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from worm_optimizer.robustness.uncertainty import Scenarios
from worm_optimizer.search.task import Array, Index, MarginTask

_BATCH = 200_000  # gaits evaluated in one call, to bound the memory
_EDGE_STROKES = 33  # strokes of the first look for an edge
_EDGE_PASSES = 12  # bisections after it


def grooves_in(
    task: MarginTask, stroke: ArrayLike, frequency: ArrayLike, scenarios: Scenarios
) -> Index:
    """Least grooves gained in an averaged cycle by each gait in each scenario, with the task's margin.

    ``stroke`` in m and ``frequency`` in Hz of shape (n,); the result has shape (n, scenarios).
    """
    strokes, frequencies = np.asarray(stroke, dtype=float), np.asarray(frequency, dtype=float)
    rows = max(1, _BATCH // len(scenarios))
    parts = [np.empty((0, len(scenarios)), dtype=np.int64)]
    for start in range(0, strokes.size, rows):
        part = slice(start, start + rows)
        gaits = strokes[part, np.newaxis], frequencies[part, np.newaxis]
        parts.append(task.grooves(*gaits, overrides=scenarios.overrides))
    return np.concatenate(parts)


def success_probability(
    task: MarginTask,
    stroke: ArrayLike,
    frequency: ArrayLike,
    promised: ArrayLike,
    scenarios: Scenarios,
) -> Array:
    """Share of the scenarios in which the robot gains the promised grooves in every averaged cycle.

    The robot has no margin: thresholds are nominal, whatever the task's margin. ``promised`` grooves per
    cycle and the result have the shape (n,) of ``stroke`` in m and ``frequency`` in Hz.
    """
    gained = grooves_in(task.with_margin(0.0), stroke, frequency, scenarios)
    return np.mean(gained >= np.asarray(promised)[:, np.newaxis], axis=1)


def stroke_to_edges(task: MarginTask, stroke: Array, frequency: Array) -> tuple[Array, Array]:
    """By how much each stroke may shrink and grow, in m, before the robot's grooves per cycle change.

    The robot is nominal (no margin). Where the branch reaches a bound of the box, the distance to the
    bound. ``stroke`` in m and ``frequency`` in Hz of shape (n,).
    """
    nominal = task.with_margin(0.0)
    branch = nominal.grooves(stroke, frequency)
    lower = _edge(nominal, stroke, frequency, branch, np.full_like(stroke, task.bounds.stroke_low))
    upper = _edge(nominal, stroke, frequency, branch, np.full_like(stroke, task.bounds.stroke_high))
    return stroke - lower, upper - stroke


def _edge(task: MarginTask, stroke: Array, frequency: Array, branch: Index, bound: Array) -> Array:
    """Stroke in m at which the branch ends on the way from ``stroke`` to ``bound``, or the bound."""
    fractions = np.linspace(0.0, 1.0, _EDGE_STROKES)
    tried = stroke[:, np.newaxis] + fractions * (bound - stroke)[:, np.newaxis]
    frequencies = np.broadcast_to(frequency[:, np.newaxis], tried.shape)
    left = task.grooves(tried, frequencies) != branch[:, np.newaxis]
    ends = left.any(axis=1)
    first = np.where(ends, np.argmax(left, axis=1), 1)
    rows = np.arange(stroke.size)
    inside, outside = tried[rows, first - 1], tried[rows, first]
    for _ in range(_EDGE_PASSES):
        middle = 0.5 * (inside + outside)
        stays = task.grooves(middle, frequency) == branch
        inside, outside = np.where(stays, middle, inside), np.where(stays, outside, middle)
    return np.where(ends, inside, bound)
