# SPDX-License-Identifier: Apache-2.0
"""Closed forms of the slow limit: groove phase, groove count and the cliff of the margin.

These formulas are not in the paper. In the slow limit (frequency towards 0), viscous friction is negligible: the fin
of one module is engaged and holds, while the other module is dragged. The number of grooves gained is the number of
times that the dragged fin passes its threshold. This number agrees with the simulator for 99 % of the gaits in the
paper's box.
"""

from __future__ import annotations

import math

from worm_model.gait import FORWARD, Gait
from worm_model.parameters import Parameters
from worm_model.simulation.actuation import actuator, length_change_range, resting_change
from worm_model.simulation.kernel.actuation_law import effective
from worm_model.simulation.kernel.mode import nearest_groove


def front_groove(parameters: Parameters) -> int:
    """Return n0, the number of the groove in which the front module starts: A2 = n0·d, with x1 = 0."""
    return int(nearest_groove(parameters.initial_length, parameters.pitch))


def groove_phase(parameters: Parameters) -> float:
    """Return φ = L0 − n0·d in m, in (−d/2, d/2], the distance of the front module from its groove at the start."""
    return parameters.initial_length - front_groove(parameters) * parameters.pitch


def deflected_share(parameters: Parameters) -> float:
    """Return κ = k_eng/(k_eng + k_dis), the part of the body's travel that deflects the dragged fin further."""
    return 1.0 / (1.0 + parameters.disengaged_stiffness / parameters.engaged_stiffness)


def switching_force(parameters: Parameters, margin: float = 0.0) -> float:
    """Return k_dis·(p_sw + δ_m − δ_c/2), the force in N of the dragged fin at its threshold."""
    threshold = parameters.switching_threshold + margin
    return parameters.disengaged_stiffness * (threshold - 0.5 * parameters.clearance)


def switching_travel(
    parameters: Parameters, margin: float = 0.0, direction: int = FORWARD
) -> float:
    """Return c, the length change in m that one switch needs, from the length at which both fins are undeflected.

    c = δ_c + (p_sw + δ_m − δ_c/2)(1 + k_dis/k_eng) + Q/k_eng. The dragged fin moves across its clearance to its
    threshold. Meanwhile the engaged fin deflects under the force of the dragged fin and the load Q, which is positive
    against the direction. If a load along the direction exceeds the force of the dragged fin, the other fin does not
    engage but is dragged as well. The function then returns c = p_sw + δ_m − δ_c/2 + F/k_dis, where F < 0 is the force
    of the dragged fin at its threshold plus Q.
    """
    half = 0.5 * parameters.clearance
    threshold = parameters.switching_threshold + margin
    held = _load(parameters, direction) + switching_force(parameters, margin)
    if held >= 0.0:
        return threshold + half + held / parameters.engaged_stiffness
    return threshold - half + held / parameters.disengaged_stiffness


def _load(parameters: Parameters, direction: int) -> float:
    """Return Q, the sum of the loads on both modules in N, positive against the direction."""
    return direction * (parameters.rear_load + parameters.front_load)


def grooves_per_cycle(gait: Gait, parameters: Parameters) -> int:
    """Return the number of grooves that a cycle gains after the transient, in the slow limit.

    The result is valid only if the engaged fin can hold the load.
    """
    lowest, highest = length_change_range(gait, parameters)
    travel = switching_travel(parameters, gait.margin, gait.direction)
    offset = -groove_phase(parameters) - highest
    first = offset + (math.floor((-travel - offset) / parameters.pitch) + 1) * parameters.pitch
    reach = first + (highest - lowest) - travel
    return max(0, math.floor(reach / parameters.pitch) + 1)


def largest_load(gait: Gait, parameters: Parameters, grooves: int = 1) -> float:
    """Return the largest load Q in N with which a gait still gains ``grooves`` a cycle, in the slow limit.

    Q is the sum of the loads on both modules, positive against the direction. The loads in ``parameters`` are ignored.
    The result is NaN if the gait does not gain these grooves without a load. The engaged fin also limits the load,
    because it must not reach its threshold before the dragged fin does: Q < (k_eng − k_dis)·(p_sw + δ_m − δ_c/2).
    """
    free = parameters.replace(rear_load=0.0, front_load=0.0)
    if grooves_per_cycle(gait, free) < grooves:
        return math.nan
    lowest, highest = length_change_range(gait, free)
    travel = switching_travel(free, gait.margin, gait.direction)
    pitch, offset = parameters.pitch, -groove_phase(parameters) - highest
    # `grooves_per_cycle` counts from ``first``, the smallest of the values offset + k·pitch above −travel. So with a
    # given ``first``, the travel lies in (−first, pitch − first]. A load increases the travel and lowers ``first``.
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
    """Return the largest load in N, as a positive number, that the fins hold at rest at the start of a gait.

    ``side`` is 1 for a load towards −x, and −1 for a load towards +x. Under this load, one fin is at its threshold. The
    other fin is short of its own threshold by p or by d − p, with the pitch d and the distance p of the front module
    from the nearest groove behind it. The larger of the two loads counts.
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

    The result is valid unless the largest allowed stroke ends the branch at a smaller margin. A negative result means
    that the branch is lost even without a margin. A load Q, positive against the direction, reduces the result by
    Q/(k_eng + k_dis).
    """
    highest = effective(-pretension, actuator(parameters))
    spare = groove_phase(parameters) + highest + 2.0 * parameters.pitch
    return (spare - switching_travel(parameters, 0.0, direction)) * deflected_share(parameters)
