# SPDX-License-Identifier: Apache-2.0
"""The robot where it rests now: its groove phase decides how many grooves a stroke gains (`docs/model.md`)."""

from __future__ import annotations

import dataclasses

from worm_model.parameters import ParameterFile
from worm_optimizer.optimizer_errors import OptimizerError

SAME_LENGTH = 1e-4  # m; initial lengths that differ by less are one: a camera measures no better


def resting_content(content: ParameterFile, initial_length: float) -> ParameterFile:
    """The parameters with the initial length in m with which a robot rests; 0 or the same one changes nothing.

    Raises `OptimizerError` on a length that no robot of these parameters has.
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
