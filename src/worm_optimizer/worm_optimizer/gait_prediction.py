# SPDX-License-Identifier: Apache-2.0
"""Record of a gait's predictions, which `robustness.prediction` computes.

The record has a module of its own because clients of the optimizer need only the record. The computation imports the
compiled kernel, which would double the time in which `operate` starts.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from worm_model.gait import Gait, gait_of


@dataclass(frozen=True, kw_only=True)
class Prediction(Gait):
    """Gait with the model's predictions for the last three of five cycles, in SI units.

    Attributes:
        speed, power, cost_of_transport, grooves_per_cycle: prediction with the gait's margin; the speed is along the
            gait's direction.
        groove_phase: groove phase for which the predictions hold, m.
        nominal_speed, nominal_power, nominal_cost_of_transport, nominal_grooves_per_cycle: prediction without the
            margin.
        stroke_to_lower_edge, stroke_to_upper_edge: decrease and increase of the stroke, m, at which the nominal branch
            ends.
        success_probability: probability that the robot gains the grooves predicted with the margin, if the groove phase
            is known.
        success_probability_any_phase: the same probability if the groove phase is uniformly distributed over a pitch.

    The last four attributes are NaN in a result of `robustness.prediction.outline`.
    """

    speed: float
    power: float
    cost_of_transport: float
    grooves_per_cycle: float
    groove_phase: float
    nominal_speed: float
    nominal_power: float
    nominal_cost_of_transport: float
    nominal_grooves_per_cycle: float
    stroke_to_lower_edge: float = math.nan
    stroke_to_upper_edge: float = math.nan
    success_probability: float = math.nan
    success_probability_any_phase: float = math.nan

    @property
    def gait(self) -> Gait:
        """The gait itself."""
        return gait_of(self)
