# SPDX-License-Identifier: Apache-2.0
"""The robot under the conditions in a pipe, and the margin that allows for a load."""

from __future__ import annotations

import dataclasses

from worm_model.conditions import LEVEL, Conditions, under
from worm_model.parameters import ParameterFile, Parameters
from worm_optimizer.search.optimizer_errors import OptimizerError


def content_under(conditions: Conditions, content: ParameterFile) -> ParameterFile:
    """Return a parameter file under conditions; the intervals move with their values.

    Raises `ParameterError` if a load is outside of its range.
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


def margin_of_force(parameters: Parameters, force: float) -> float:
    """Return the margin in m that allows for a load in N, Q/(k_eng + k_dis), in the slow limit.

    Raises `OptimizerError` for a force that is negative or not finite.
    """
    if not 0.0 <= force < float("inf"):
        raise OptimizerError(f"margin_force: {force} N: give a finite number that is not negative")
    return force / (parameters.engaged_stiffness + parameters.disengaged_stiffness)
