# SPDX-License-Identifier: Apache-2.0
"""Loads on the modules that follow from the conditions in the pipe."""

from __future__ import annotations

import dataclasses

from worm_model.parameters import ParameterFile, Parameters
from worm_msgs.conditions import LEVEL, Conditions


def under(conditions: Conditions, parameters: Parameters) -> Parameters:
    """Return the parameters of a robot under conditions; `LEVEL` leaves the parameters unchanged.

    The load on each module increases by its weight along the pipe and by its drag at rest. The load on the rear module
    also increases by the pull of the tether at the start. With the density ρ and the velocity U of the water, the drag
    of a module with the velocity x′ is ρ/2·C_dA·(U + x′)·|U + x′|. The derivative of the drag at x′ = 0, ρ·C_dA·|U|, is
    added to the viscous friction. The remaining part of the drag, ρ/2·C_dA·x′², the growth of the tether during a run,
    and buoyancy are neglected. A drag area in still water, or a pull per metre of a tether whose length and
    constant pull are 0, thus leaves the parameters unchanged.

    Raises `ParameterError` if a load or the friction is then outside its range.
    """
    weight, drag = conditions.gravity, conditions.drag()
    resting = drag * conditions.flow_m_per_s
    return parameters.replace(
        rear_load=parameters.rear_load
        + parameters.rear_mass * weight
        + conditions.tether()
        + resting,
        front_load=parameters.front_load + parameters.front_mass * weight + resting,
        viscous_friction=parameters.viscous_friction + 2.0 * drag,
    )


def content_under(conditions: Conditions, content: ParameterFile) -> ParameterFile:
    """Return the content of a parameter file under conditions; the interval of a parameter moves with its value.

    Raises `ParameterError` as `under` does.
    """
    if conditions == LEVEL:
        return content
    parameters = under(conditions, content.parameters)
    before, after = content.parameters.as_dict(), parameters.as_dict()
    intervals = {
        key: (low + after[key] - before[key], high + after[key] - before[key])
        for key, (low, high) in content.intervals.items()
    }
    return dataclasses.replace(content, parameters=parameters, intervals=intervals)
