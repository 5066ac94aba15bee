# SPDX-License-Identifier: Apache-2.0
"""Commands to a robot, and their texts."""

import math

import pytest

from worm_model.errors import InputError
from worm_model.gait import Gait
from worm_optimizer.robot_commands import GaitCommand, RunProgress

GAIT = Gait(0.07, 0.2, -1)


@pytest.mark.parametrize(
    ("ends", "complaint"),
    [
        ({}, "needs an end"),
        ({"cycles": -1}, "cycles: -1"),
        ({"cycles": 1001}, "cycles: 1001"),
        ({"grooves": -2}, "grooves: -2"),
        ({"distance": math.nan}, "distance: nan m"),
        ({"distance": -0.1}, "distance: -0.1 m"),
    ],
)
def test_an_impossible_end_is_rejected(ends, complaint):
    with pytest.raises(InputError, match=complaint):
        GaitCommand(GAIT, **ends)


def test_progress_leaves_out_missing_measurements():
    nan = math.nan
    assert str(RunProgress(0, -1.0, nan, nan, 0.8)) == "resting"
    assert str(RunProgress(2, 3.0, nan, nan, 2.5)) == "cycle 2, 2.50 W"
    assert str(RunProgress(2, 3.0, 1.96, 0.034, nan)) == "cycle 2, +34.0 mm, +2.0 grooves"
