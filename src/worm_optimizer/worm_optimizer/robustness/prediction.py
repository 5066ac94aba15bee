# SPDX-License-Identifier: Apache-2.0
"""Predictions for gaits: with and without the margin, success probabilities, and distances to the ends of branches."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from worm_model.parameters import ParameterFile
from worm_model.simulation.batch import GaitTable, branch_of
from worm_model.simulation.closed_form import groove_phase
from worm_model.simulation.simulator import cost_of_transport
from worm_optimizer.evaluation.actuator_limits import NO_LIMITS
from worm_optimizer.evaluation.command_shape import SINUSOID, Shapes
from worm_optimizer.evaluation.runs import find_runs
from worm_optimizer.evaluation.task import EDGE_TOLERANCE, Array, Index, MarginTask
from worm_optimizer.gait_prediction import Prediction
from worm_optimizer.robustness.uncertainty import Scenarios, phase_known, phase_unknown

_BATCH = 200_000  # largest number of gaits that are evaluated in one call, which bounds the memory
_SCANNED_STROKES = 41  # number of strokes in the scan for the ends of a gait's branch


def outline(
    task: MarginTask,
    stroke: Array,
    frequency: Array,
    margin: Array,
    shape: Shapes = SINUSOID,
) -> tuple[Prediction, ...]:
    """Predict gaits with and without their margins, but without distances to edges and success probabilities.

    ``stroke`` in m, ``frequency`` in Hz, ``margin`` in m and ``shape`` have shape (n,). The task defines the direction
    and the robot.
    """
    robust = task.table(stroke, frequency, margin, shape=shape)
    nominal = task.table(stroke, frequency, np.zeros_like(margin), shape=shape)
    columns = {
        **robust.gait,
        "direction": np.full(stroke.shape, task.direction),
        **_results(task, robust),
        "groove_phase": np.full_like(stroke, groove_phase(task.parameters)),
        **{f"nominal_{name}": values for name, values in _results(task, nominal).items()},
    }
    rows = zip(*(np.asarray(values).tolist() for values in columns.values()), strict=True)
    return tuple(Prediction(**dict(zip(columns, row, strict=True))) for row in rows)


def predict(
    task: MarginTask,
    content: ParameterFile,
    stroke: Array,
    frequency: Array,
    margin: Array,
    samples: int,
    seed: int,
    shape: Shapes = SINUSOID,
) -> tuple[Prediction, ...]:
    """Predict gaits with all fields of `Prediction`; see `outline`.

    ``samples`` parameter sets are drawn with ``seed`` from the uncertainty in ``content``.
    """
    robust_grooves = branch_of(task.table(stroke, frequency, margin, shape=shape))
    lower, upper = stroke_to_ends(task, stroke, frequency, shape)
    known, unknown = (
        success_probability(
            task, stroke, frequency, robust_grooves, draw(content, samples, seed), shape
        )
        for draw in (phase_known, phase_unknown)
    )
    rows = zip(lower.tolist(), upper.tolist(), known.tolist(), unknown.tolist(), strict=True)
    return tuple(
        replace(
            gait,
            stroke_to_lower_edge=to_lower,
            stroke_to_upper_edge=to_upper,
            success_probability=phase_is_known,
            success_probability_any_phase=any_phase,
        )
        for gait, (to_lower, to_upper, phase_is_known, any_phase) in zip(
            outline(task, stroke, frequency, margin, shape), rows, strict=True
        )
    )


def _results(task: MarginTask, table: GaitTable) -> dict[str, Array]:
    """Return speed, power, cost of transport and grooves per cycle of a table."""
    return {
        "speed": table.speed,
        "power": table.power,
        "cost_of_transport": cost_of_transport(table.speed, table.power, task.parameters.mass),
        "grooves_per_cycle": table.grooves_per_cycle,
    }


def grooves_in(
    task: MarginTask,
    stroke: ArrayLike,
    frequency: ArrayLike,
    scenarios: Scenarios,
    shape: Shapes = SINUSOID,
) -> Index:
    """For each scenario, return the grooves of each gait in its worst averaged cycle, with the task's margin.

    ``stroke`` in m and ``frequency`` in Hz have shape (n,), the result has shape (n, scenarios). ``shape`` is the
    command shape of each gait, or of all (`evaluation.command_shape`).
    """
    strokes, frequencies = np.asarray(stroke, dtype=float), np.asarray(frequency, dtype=float)
    shapes = np.broadcast_to(shape, strokes.shape)
    rows = max(1, _BATCH // len(scenarios))
    parts = [np.empty((0, len(scenarios)), dtype=np.int64)]
    for start in range(0, strokes.size, rows):
        part = slice(start, start + rows)
        gaits = strokes[part, np.newaxis], frequencies[part, np.newaxis]
        own = shapes[part, np.newaxis]
        parts.append(task.grooves(*gaits, overrides=scenarios.overrides, shape=own))
    return np.concatenate(parts)


def success_probability(
    task: MarginTask,
    stroke: ArrayLike,
    frequency: ArrayLike,
    required: ArrayLike,
    scenarios: Scenarios,
    shape: Shapes = SINUSOID,
) -> Array:
    """Return the share of the scenarios in which each gait gains the required grooves in every averaged cycle.

    The task's margin is ignored. ``required`` (grooves per cycle), ``stroke`` in m, ``frequency`` in Hz and the result
    have shape (n,).
    """
    gained = grooves_in(task.with_margin(0.0), stroke, frequency, scenarios, shape)
    return np.mean(gained >= np.asarray(required)[:, np.newaxis], axis=1)


def stroke_to_ends(
    task: MarginTask, stroke: Array, frequency: Array, shape: Shapes = SINUSOID
) -> tuple[Array, Array]:
    """Return by how much each stroke may decrease and increase before the grooves per cycle change, m, shape (n,) each.

    The task's margin and limits are ignored. If a branch reaches a bound of the box, the result is the distance to this
    bound. ``stroke`` in m and ``frequency`` in Hz have shape (n,).
    """
    nominal = replace(task, margin=0.0, limits=NO_LIMITS)
    box, shapes = task.bounds, np.broadcast_to(shape, stroke.shape)
    most = np.maximum(box.stroke_high - shapes["pretension"], stroke)

    def label(strokes: Array, column: Index) -> Index:
        return nominal.points(strokes, frequency[column], shapes[column]).count

    scan = np.linspace(np.full(stroke.shape, box.stroke_low), most, _SCANNED_STROKES, axis=1)
    strokes = np.column_stack([scan, stroke])
    intervals = find_runs(label, np.sort(strokes, axis=1), EDGE_TOLERANCE)
    own = (intervals.low <= stroke[intervals.column]) & (stroke[intervals.column] <= intervals.high)
    # A column is the scan over the strokes of one gait. The scan contains the gait's own stroke, so exactly one
    # interval of equal count contains it.
    place = np.flatnonzero(own)[np.unique(intervals.column[own], return_index=True)[1]]
    lower = np.where(intervals.stepped[place], intervals.low[place], box.stroke_low)
    following = np.minimum(place + 1, len(intervals.column) - 1)
    is_last = (following == place) | ~intervals.stepped[following]
    upper = np.where(is_last, most, intervals.high[place])
    return stroke - lower, upper - stroke
