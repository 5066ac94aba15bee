# SPDX-License-Identifier: Apache-2.0
"""The groove phase from the first cycles, where no instrument gives the initial length.

The phase decides how many grooves a cycle gains. If the robot gains another number than predicted in ``CYCLES``
cycles running, L0 is moved to the nearest value with which the simulator predicts the number that was seen.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from worm_model.gait import Gait
from worm_model.parameters import Parameters
from worm_model.simulation.simulator import SimulationError, evaluate_gait

CYCLES = 2
STEP_M = 0.0005


def length_for(gait: Gait, parameters: Parameters, gained: int) -> float | None:
    """L0 in m nearest to the present one, within half a pitch, that gains ``gained`` more a cycle, or None."""
    nominal = replace(gait, margin=0.0)
    try:
        wanted = _grooves(nominal, parameters) + gained
        reach = np.arange(STEP_M, 0.5 * parameters.pitch, STEP_M).tolist()
        candidates = (parameters.initial_length + s * step for step in reach for s in (1, -1))
        for length in candidates:
            if _grooves(nominal, parameters.replace(initial_length=length)) == wanted:
                return float(length)
    except SimulationError:
        pass
    return None


def _grooves(gait: Gait, parameters: Parameters) -> int:
    return round(evaluate_gait(gait, parameters).grooves_per_cycle)
