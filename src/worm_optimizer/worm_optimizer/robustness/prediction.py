# SPDX-License-Identifier: Apache-2.0
"""All that is predicted of a gait: robust and nominal prediction, distances to the edges, probabilities."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from worm_model.gait import Gait
from worm_model.parameters import ParameterFile
from worm_model.simulation.batch import GaitTable
from worm_model.simulation.closed_form import groove_phase
from worm_optimizer.robustness.success_probability import stroke_to_edges, success_probability
from worm_optimizer.robustness.uncertainty import phase_known, phase_unknown
from worm_optimizer.search.task import Array, MarginTask, branch_of


@dataclass(frozen=True)
class Prediction:
    """What the model says of a gait over the last three of five cycles; SI units.

    ``speed`` (along the gait's direction), ``power``, ``cost_of_transport`` and ``grooves_per_cycle`` are
    with the gait's margin, the nominal ones without; ``groove_phase`` is the one that they hold for; then
    the distances to the edges of the nominal branch in m and the probabilities that the robot gains the
    predicted grooves.
    """

    stroke: float
    frequency: float
    direction: int
    margin: float
    speed: float
    power: float
    cost_of_transport: float
    grooves_per_cycle: float
    groove_phase: float
    nominal_speed: float
    nominal_power: float
    nominal_cost_of_transport: float
    nominal_grooves_per_cycle: float
    stroke_to_lower_edge: float
    stroke_to_upper_edge: float
    success_probability: float
    success_probability_any_phase: float

    @property
    def gait(self) -> Gait:
        """The gait itself."""
        return Gait(self.stroke, self.frequency, self.direction, self.margin)


def predict(
    task: MarginTask,
    content: ParameterFile,
    stroke: Array,
    frequency: Array,
    margin: Array,
    samples: int,
    seed: int,
) -> tuple[Prediction, ...]:
    """Predicts gaits with all that `Prediction` holds.

    ``stroke`` in m, ``frequency`` in Hz and ``margin`` in m of shape (n,) make the gaits, the task their
    direction and model; ``content`` the uncertainty, of which ``samples`` are drawn with ``seed``.
    """
    robust = task.table(stroke, frequency, margin=margin)
    nominal = task.table(stroke, frequency, margin=np.zeros_like(margin))
    promised = branch_of(robust)
    lower, upper = stroke_to_edges(task, stroke, frequency)
    known, unknown = (
        success_probability(task, stroke, frequency, promised, draw(content, samples, seed))
        for draw in (phase_known, phase_unknown)
    )
    phase = np.full_like(stroke, groove_phase(task.parameters))
    columns = (
        *(stroke, frequency, np.full(stroke.shape, task.direction), margin),
        *_figures(robust),
        phase,
        *_figures(nominal),
        *(lower, upper, known, unknown),
    )
    return tuple(
        Prediction(*row) for row in zip(*(np.asarray(c).tolist() for c in columns), strict=True)
    )


def _figures(table: GaitTable) -> tuple[Array, ...]:
    """Speed, power, cost of transport and grooves per cycle of a table of gaits."""
    return table.speed, table.power, table.cost_of_transport, table.grooves_per_cycle
