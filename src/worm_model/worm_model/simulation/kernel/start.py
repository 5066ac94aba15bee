# SPDX-License-Identifier: Apache-2.0
"""State in which a run begins: at rest and, under a load, in the equilibrium of the fins."""

from __future__ import annotations

from typing import Any

from worm_model.simulation.kernel import mode
from worm_model.simulation.kernel.actuation_law import Actuator, rest_of
from worm_model.simulation.kernel.compiled import compiled
from worm_model.simulation.kernel.guard import NEVER

REGIONS = 3


@compiled
def _balance(offset: float, c: mode.Constants) -> tuple[float, int, int]:
    """Return (deflection of the rear fin in m, region of the rear fin, region of the front fin) in the equilibrium.

    ``offset`` in m is the deflection of the front fin minus that of the rear one. For each pair of regions, the
    equilibrium of the fins with the load is computed as if the fins were in these regions. The sum of both
    fin forces increases with the deflection. So exactly one pair contains the equilibrium that is computed for it,
    except for rounding at a border. The function returns the pair whose equilibrium lies least outside of its regions.
    """
    best, deflection, regions = NEVER, 0.0, 0
    for pair in range(REGIONS * REGIONS):
        rear, front = pair // REGIONS, pair % REGIONS
        rear_k, front_k = (
            mode.fin_stiffness(rear, c.rear_fin),
            mode.fin_stiffness(front, c.front_fin),
        )
        if rear_k + front_k == 0.0:
            continue
        rear_rest = (rear - 1.0) * c.body.half_clearance
        front_rest = (front - 1.0) * c.body.half_clearance - offset
        x = (rear_k * rear_rest + front_k * front_rest - c.resistance.load) / (rear_k + front_k)
        outside = max(_outside(x, rear, c), _outside(x + offset, front, c))
        if outside < best:
            best, deflection, regions = outside, x, pair
    return deflection, regions // REGIONS, regions % REGIONS


@compiled
def _outside(deflection: float, region: int, c: mode.Constants) -> float:
    """Return the distance by which a deflection lies outside of a region, m."""
    if region == mode.ABOVE:
        return max(c.body.half_clearance - deflection, 0.0)
    if region == mode.BELOW:
        return max(deflection + c.body.half_clearance, 0.0)
    return max(abs(deflection) - c.body.half_clearance, 0.0)


@compiled
def start_of(g: Any, c: mode.Constants, a: Actuator) -> tuple[bool, float, mode.Motion]:
    """Return (True if the fins hold the load, ΔL in m, the motion) at the start of a gait.

    ``g`` is a row of GAIT_ROW. Without a load, x1 = 0. With a load, the fins are in equilibrium with it. The front
    anchor is the groove nearest to the front module at ΔL = 0. A fin beyond its threshold slips into the next groove at
    once, the rear fin first. The fins do not hold the load if the slipping does not end. v1 = 0, so that y′ = μ·L′.
    """
    length_change = rest_of(g.pretension, a)
    length_rate = 0.0 if g.pretension > 0.0 else -a.gain * a.slack / a.time_constant
    rear_groove, front_groove = 0, int(mode.nearest_groove_of(c.body.initial_length, c.body.pitch))
    slips = int(abs(length_change) / c.body.pitch) + 4
    for _ in range(slips):
        gap = (front_groove - rear_groove) * c.body.pitch
        offset = c.body.initial_length + length_change - gap
        if c.resistance.load != 0.0:
            rear, rear_region, front_region = _balance(offset, c)
        else:
            rear = -rear_groove * c.body.pitch
            rear_region = mode.region_of(rear, c.body.half_clearance)
            front_region = mode.region_of(rear + offset, c.body.half_clearance)
        if abs(rear) > c.rear_fin.threshold:
            rear_groove += 1 if rear > 0.0 else -1
        elif abs(rear + offset) > c.front_fin.threshold:
            front_groove += 1 if rear + offset > 0.0 else -1
        else:
            y = rear + rear_groove * c.body.pitch + c.body.mu * length_change
            motion = mode.Motion(
                y, c.body.mu * length_rate, rear_groove, front_groove, rear_region, front_region
            )
            return True, length_change, motion
    return False, length_change, mode.Motion(0.0, 0.0, rear_groove, front_groove, 1, 1)
