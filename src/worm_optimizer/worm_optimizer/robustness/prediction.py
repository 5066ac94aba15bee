# SPDX-License-Identifier: Apache-2.0
"""Predictions for a gait: with and without its margin, distances to the edges, and success probabilities."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from worm_model.parameters import ParameterFile
from worm_model.simulation.batch import GaitTable, branch_of
from worm_model.simulation.closed_form import groove_phase
from worm_model.simulation.simulator import cost_of_transport
from worm_optimizer.evaluation.command_shape import SINUSOID, Shapes
from worm_optimizer.evaluation.task import Array, MarginTask
from worm_optimizer.gait_prediction import Prediction
from worm_optimizer.robustness.success_probability import stroke_to_ends, success_probability
from worm_optimizer.robustness.uncertainty import phase_known, phase_unknown


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
    holding_power = task.held_power(stroke, frequency, np.broadcast_to(shape, stroke.shape))
    columns = {
        **robust.gait,
        "direction": np.full(stroke.shape, task.direction),
        **_results(task, robust, holding_power),
        "groove_phase": np.full_like(stroke, groove_phase(task.parameters)),
        **{
            f"nominal_{name}": values
            for name, values in _results(task, nominal, holding_power).items()
        },
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
    more = zip(*(column.tolist() for column in (lower, upper, known, unknown)), strict=True)
    return tuple(
        replace(
            gait,
            stroke_to_lower_edge=to_lower,
            stroke_to_upper_edge=to_upper,
            success_probability=phase_is_known,
            success_probability_any_phase=any_phase,
        )
        for gait, (to_lower, to_upper, phase_is_known, any_phase) in zip(
            outline(task, stroke, frequency, margin, shape), more, strict=True
        )
    )


def _results(task: MarginTask, table: GaitTable, holding_power: Array) -> dict[str, Array]:
    """Return speed, power, cost of transport and grooves per cycle of a table.

    The power includes ``holding_power`` (W), which the servos need in addition to hold the mean cable force.
    """
    power = table.power + holding_power
    return {
        "speed": table.speed,
        "power": power,
        "cost_of_transport": cost_of_transport(table.speed, power, task.parameters.mass),
        "grooves_per_cycle": table.grooves_per_cycle,
    }
