# SPDX-License-Identifier: Apache-2.0
"""A request for where the robot rests: the gait gains its grooves there, where the front's own may not."""

import dataclasses

import pytest
from gaits_for_tests import QUICK

from worm_model.parameters import PAPER, ParameterFile
from worm_model.simulation.simulator import evaluate_gait
from worm_optimizer.optimizer_errors import OptimizerError
from worm_optimizer.search.front import make_front
from worm_optimizer.search.resting_phase import resting_content

CONTENT = ParameterFile()
SETTINGS = dataclasses.replace(QUICK, margin=0.002)


@pytest.mark.parametrize("shift", [-0.006, -0.002, 0.003, 0.007])
def test_the_gait_gains_with_its_margin_what_is_promised_at_the_phase_of_the_robot(shift):
    length = PAPER.initial_length + shift
    here = resting_content(CONTENT, length)
    gait = make_front(here, SETTINGS, 1).cruise
    resting = evaluate_gait(gait.gait, PAPER.replace(initial_length=length))
    assert gait.margin == 0.002
    assert gait.speed == pytest.approx(resting.speed, rel=1e-12)
    assert gait.grooves_per_cycle >= 0.95
    pitch = PAPER.pitch
    assert gait.groove_phase == pytest.approx((length + pitch / 2) % pitch - pitch / 2, abs=1e-9)


@pytest.mark.parametrize("length", [0.0, PAPER.initial_length, PAPER.initial_length + 9e-5])
def test_the_phase_of_the_parameters_changes_nothing(length):
    assert resting_content(CONTENT, length) is CONTENT


@pytest.mark.parametrize("length", [float("nan"), -0.1, 1.2])
def test_a_length_of_another_robot_is_rejected(length):
    with pytest.raises(OptimizerError, match="initial_length"):
        resting_content(CONTENT, length)
