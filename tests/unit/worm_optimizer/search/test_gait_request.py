# SPDX-License-Identifier: Apache-2.0
"""Requests and their exact answers."""

import dataclasses
import math

import pytest
from gaits_for_tests import QUICK, small_front
from hypothesis import given
from hypothesis import strategies as st
from random_cases import examples

from worm_model.errors import InputError
from worm_model.parameters import PAPER, ParameterFile
from worm_model.simulation.simulator import evaluate_gait
from worm_optimizer.search.front import make_front
from worm_optimizer.search.gait_request import (
    GaitRequest,
    Objective,
    RequestStatus,
    request_of,
    resting_content,
    select,
)

FRONT = small_front()
SLOWEST, FASTEST = FRONT.three["min_power"], FRONT.three["max_speed"]


def at_speed(speed: float):
    return select(FRONT, GaitRequest(Objective.MIN_POWER_AT_SPEED, speed))


def at_power(power: float):
    return select(FRONT, GaitRequest(Objective.MAX_SPEED_AT_POWER, power))


def test_the_issues_request_is_exact():
    gait = at_speed(0.004).prediction
    assert abs(gait.speed - 0.004) < 1e-8
    assert gait.power <= 2.1155
    assert evaluate_gait(gait.gait).speed == pytest.approx(gait.speed, rel=1e-12)


@examples(10)
@given(st.floats(SLOWEST.speed, FASTEST.speed))
def test_the_lowest_power_at_a_reachable_speed(speed):
    answer = at_speed(speed)
    assert answer.status is RequestStatus.DONE
    assert answer.prediction.speed >= speed * (1.0 - 1e-9)
    fast_enough = [gait.power for gait in FRONT.gaits if gait.speed >= speed]
    assert answer.prediction.power <= min(fast_enough, default=math.inf) * (1.0 + 1e-9)


@examples(10)
@given(st.floats(SLOWEST.power * 1.001, FASTEST.power * 1.2))
def test_the_highest_speed_at_a_sufficient_power(power):
    answer = at_power(power)
    assert answer.status is RequestStatus.DONE
    assert answer.prediction.power <= power * (1.0 + 1e-9)
    affordable = [gait.speed for gait in FRONT.gaits if gait.power <= power]
    assert answer.prediction.speed >= max(affordable) * (1.0 - 1e-9)


def test_the_unreachable_is_rejected_with_the_nearest():
    fast = at_speed(0.02)
    assert fast.status is RequestStatus.UNREACHABLE
    assert "0.02 m/s" in fast.message
    assert fast.prediction == FASTEST
    frugal = at_power(1.0)
    assert frugal.status is RequestStatus.UNREACHABLE
    assert f"{SLOWEST.power:.6g} W" in frugal.message
    assert frugal.prediction == SLOWEST


@pytest.mark.parametrize(
    ("values", "named"),
    [
        ((3, -1.0, 1.0), "speed"),
        ((3, math.nan, 1.0), "speed"),
        ((4, 1.0, 0.0), "power"),
        ((4, 1.0, math.inf), "power"),
        ((9, 0.0, 0.0), "9 is none of 0 MIN_POWER, 1 CRUISE"),
    ],
)
def test_a_request_of_impossible_values_is_rejected(values, named):
    with pytest.raises(InputError, match=named):
        request_of(*values)
    assert request_of(1, math.nan, -1.0).objective is Objective.CRUISE


CONTENT = ParameterFile()
SETTINGS = dataclasses.replace(QUICK, margin=0.002)


@pytest.mark.parametrize("shift", [-0.006, -0.002, 0.003, 0.007])
def test_the_gait_gains_with_its_margin_what_is_promised_at_the_phase_of_the_robot(shift):
    length = PAPER.initial_length + shift
    here = resting_content(CONTENT, length)
    gait = make_front(here, SETTINGS, 1).three["cruise"]
    resting = evaluate_gait(gait.gait, PAPER.replace(initial_length=length))
    assert gait.margin == 0.002
    assert gait.speed == pytest.approx(resting.speed, rel=1e-12)
    assert gait.grooves_per_cycle >= 0.95
    pitch = PAPER.pitch
    assert gait.groove_phase == pytest.approx((length + pitch / 2) % pitch - pitch / 2, abs=1e-9)


@pytest.mark.parametrize("length", [0.0, PAPER.initial_length, PAPER.initial_length + 9e-5])
def test_the_phase_of_the_parameters_changes_nothing(length):
    assert resting_content(CONTENT, length) is CONTENT
