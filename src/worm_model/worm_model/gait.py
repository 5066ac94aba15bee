# SPDX-License-Identifier: Apache-2.0
"""Gaits in the model: the public names of `worm_msgs.gait`, the paper's box, and checks and files of the model."""

from __future__ import annotations

import dataclasses
from typing import Any

from worm_msgs.gait import FORWARD, REVERSE, Gait, GaitError, Profile, gait_of  # noqa: F401 - names of this public module

# The paper's box of gaits (below eq:moo_formulation).
STROKE_RANGE = (0.01, 0.09)  # m
FREQUENCY_RANGE = (0.08, 0.4)  # Hz

CYCLES = 5  # number of cycles of a run, from the start
AVERAGED = 3  # number of cycles at the end of the run over which speed and power are averaged


def named_values(gait: Gait) -> dict[str, Any]:
    """Return the fields of a gait, or of a prediction with the fields of a gait, for JSON and YAML files.

    The profile is represented by its name.
    """
    return dataclasses.asdict(gait) | {"profile": str(gait.profile)}


def check_body(reach: float, length: float) -> None:
    """Raise `GaitError` unless the largest contraction ``reach`` (o + S) is below the body length at rest, in m."""
    if reach >= length:
        raise GaitError(
            f"stroke: {reach:g} m with the pretension; the body is {length:g} m long. Use less than {length:g} m"
        )
