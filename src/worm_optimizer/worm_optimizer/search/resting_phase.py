# SPDX-License-Identifier: Apache-2.0
"""Parameters with the present groove phase, which determines how many grooves a stroke gains (`docs/model.md`)."""

from __future__ import annotations

import dataclasses

from worm_model.parameters import ParameterFile
from worm_optimizer.optimizer_errors import OptimizerError

SAME_LENGTH = 1e-4  # m; lengths that differ by less are equal, as a camera is not more accurate


def resting_content(content: ParameterFile, initial_length: float) -> ParameterFile:
    """Return the parameters with the initial length in m of a robot at rest. 0 or the same length changes nothing.

    Raises `OptimizerError` if the length differs from the parameters' by half of it or more.
    """
    known = content.parameters.initial_length
    if not initial_length or abs(initial_length - known) < SAME_LENGTH:
        return content
    if not abs(initial_length - known) < known / 2.0:
        raise OptimizerError(
            f"initial_length: {initial_length} m is far from the parameters' {known} m"
        )
    return dataclasses.replace(
        content, parameters=content.parameters.replace(initial_length=initial_length)
    )
