# SPDX-License-Identifier: Apache-2.0
"""Closed forms of the slow limit: groove phase, groove count and the cliff of the margin.

These formulas are not in the paper. In the slow limit the viscous friction is negligible: the module whose fins are
engaged holds while the other module is dragged. The grooves gained are the number of times that the dragged fin passes
its threshold. This number agrees with the simulator for 99 % of the gaits in the paper's box.
"""

from __future__ import annotations

import math

from worm_model.gait import FORWARD, Gait
from worm_model.parameters import Parameters
from worm_model.simulation.actuation import actuator, length_change_range, resting_change
from worm_model.simulation.kernel.actuation_law import effective
from worm_model.simulation.kernel.mode import nearest_groove


def front_groove(parameters: Parameters) -> int:
    """Return the number n of the groove nearest to the front module at the start: A2 = n·d, x1 = 0."""
    return int(nearest_groove(parameters.initial_length, parameters.pitch))


def groove_phase(parameters: Parameters) -> float:
    """Return φ = L0 − n·d in m, in (−d/2, d/2], the distance of the front module from its groove at the start."""
    return parameters.initial_length - front_groove(parameters) * parameters.pitch


def switching_travel(
    parameters: Parameters, margin: float = 0.0, direction: int = FORWARD
) -> float:
    """Return the length change c in m from one threshold to the other.

    c = δ_c + (p_sw + δ_m − δ_c/2)(1 + k_dis/k_eng) + Q/k_eng. The dragged fin moves across its clearance to its
    threshold. Meanwhile the engaged fin deflects under the dragged fin's force and the load Q against the direction.
    If a load along the direction exceeds the dragged fin's force, the other fin does not engage but is dragged as well.
    """
    half = 0.5 * parameters.clearance
    threshold = parameters.switching_threshold + margin
    held = _load(parameters, direction) + parameters.disengaged_stiffness * (threshold - half)
    if held >= 0.0:
        return threshold + half + held / parameters.engaged_stiffness
    return threshold - half + held / parameters.disengaged_stiffness


def _load(parameters: Parameters, direction: int) -> float:
    """Return the load of both modules in N, positive against the direction."""
    return direction * (parameters.rear_load + parameters.front_load)


def grooves_per_cycle(gait: Gait, parameters: Parameters) -> int:
    """Return the grooves that a cycle gains after the transient, in the slow limit.

    The engaged fin must be able to hold the load.
    """
    lowest, highest = length_change_range(gait, parameters)
    travel = switching_travel(parameters, gait.margin, gait.direction)
    offset = -groove_phase(parameters) - highest
    first = offset + (math.floor((-travel - offset) / parameters.pitch) + 1) * parameters.pitch
    reach = first + (highest - lowest) - travel
    return max(0, math.floor(reach / parameters.pitch) + 1)


def largest_load(gait: Gait, parameters: Parameters, grooves: int = 1) -> float:
    """Return the load Q1 + Q2 in N against the direction up to which a gait gains ``grooves`` a cycle, slow limit.

    The loads in ``parameters`` are ignored. The result is NaN if the gait does not gain these grooves without a load.
    The engaged fin also limits the load, because it must not reach its threshold before the dragged fin does:
    Q < (k_eng − k_dis)·(p_sw + δ_m − δ_c/2).
    """
    free = parameters.replace(rear_load=0.0, front_load=0.0)
    if grooves_per_cycle(gait, free) < grooves:
        return math.nan
    lowest, highest = length_change_range(gait, free)
    travel = switching_travel(free, gait.margin, gait.direction)
    pitch, offset = parameters.pitch, -groove_phase(parameters) - highest
    # the travel lies in (−first, pitch − first] for the point ``first`` of the lattice from which a cycle counts
    firsts = [offset + (math.floor((-travel - offset) / pitch) + 1 - k) * pitch for k in range(50)]
    swing = highest - lowest - (grooves - 1) * pitch
    longest = max(
        (min(pitch - first, first + swing) for first in firsts if first + swing > -first),
        default=travel,
    )
    half = 0.5 * parameters.clearance
    deflection = parameters.switching_threshold + gait.margin - half
    held = (parameters.engaged_stiffness - parameters.disengaged_stiffness) * deflection
    return min((longest - travel) * parameters.engaged_stiffness, held)


def largest_static_load(parameters: Parameters, side: int, gait: Gait) -> float:
    """Return the size in N of the load that the fins hold at the start of a gait, towards −x (``side`` 1) or +x (−1).

    One fin is at its threshold. The distance of the other fin from its threshold is the phase of the front module
    between two grooves, or the pitch minus this phase.
    """
    stiff, soft = parameters.engaged_stiffness, parameters.disengaged_stiffness
    if side != gait.direction:
        stiff, soft = soft, stiff
    half, threshold = 0.5 * parameters.clearance, parameters.switching_threshold + gait.margin
    rest = resting_change(gait, parameters)
    phase = (groove_phase(parameters) + rest) % parameters.pitch

    def held(deflection: float) -> float:
        return stiff * max(deflection - half, 0.0) - soft * max(-deflection - half, 0.0)

    offsets = (phase, parameters.pitch - phase)
    return held(threshold) + max(held(threshold - offset) for offset in offsets)


def cliff_margin(
    parameters: Parameters, direction: int = FORWARD, pretension: float = 0.0
) -> float:
    """Return the margin δ_m* in m beyond which the branch with two grooves a cycle is lost, in the slow limit.

    The value is valid unless the largest allowed stroke ends the branch at a smaller margin. A negative value means
    that the branch is lost even without a margin. A load Q against the direction reduces the value by
    Q/(k_eng + k_dis).
    """
    yielding = 1.0 + parameters.disengaged_stiffness / parameters.engaged_stiffness
    highest = effective(-pretension, actuator(parameters))
    spare = groove_phase(parameters) + highest + 2.0 * parameters.pitch
    return (spare - switching_travel(parameters, 0.0, direction)) / yielding
