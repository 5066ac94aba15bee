# SPDX-License-Identifier: Apache-2.0
"""Gaits chosen from a front, and answers to requests."""

import math

import pytest
from gaits_for_tests import made_up, made_up_front
from hypothesis import given
from hypothesis import strategies as st

from worm_optimizer.search.gait_request import (
    GaitAnswer,
    GaitRequest,
    Objective,
    RequestStatus,
    answer,
    request_of,
    select,
    three_gaits,
)
from worm_optimizer.search.optimizer_errors import OptimizerError

FRONT = made_up_front().predictions


def test_the_three_gaits():
    three = three_gaits(FRONT)
    assert {name: gait.speed for name, gait in three.items()} == {
        "min_power": 0.002,
        "cruise": 0.005,
        "max_speed": 0.008,
    }


@given(st.floats(0.0, 0.008))
def test_the_lowest_power_at_a_reachable_speed(speed):
    choice = select(FRONT, GaitRequest(Objective.MIN_POWER_AT_SPEED, speed))
    fast_enough = [gait for gait in FRONT if gait.speed >= speed]
    assert choice.status is RequestStatus.DONE
    assert choice.prediction.power == min(gait.power for gait in fast_enough)


@given(st.floats(1.4, 100.0))
def test_the_highest_speed_at_a_sufficient_power(power):
    choice = select(FRONT, GaitRequest(Objective.MAX_SPEED_AT_POWER, power))
    assert choice.status is RequestStatus.DONE
    assert choice.prediction.speed == max(gait.speed for gait in FRONT if gait.power <= power)


def test_a_value_read_off_the_front_is_reachable():
    front = [made_up(0.1 + 0.2, 1.0 / 3.0)]
    assert (
        select(front, GaitRequest(Objective.MIN_POWER_AT_SPEED, 0.3)).status is RequestStatus.DONE
    )
    assert (
        select(front, GaitRequest(Objective.MAX_SPEED_AT_POWER, 0.333333333333)).status
        is RequestStatus.DONE
    )


def test_the_unreachable_is_refused_with_the_nearest():
    fast = select(FRONT, GaitRequest(Objective.MIN_POWER_AT_SPEED, 0.02))
    assert "reaches 0.02 m/s: the fastest makes 0.008 m/s" in fast.message
    assert fast.prediction.speed == 0.008
    frugal = select(FRONT, GaitRequest(Objective.MAX_SPEED_AT_POWER, 1.0))
    assert "the lowest power is 1.4 W" in frugal.message
    assert frugal.prediction.power == 1.4


@pytest.mark.parametrize("speed", [-1.0, math.nan, math.inf])
def test_a_speed_that_is_none_is_refused(speed):
    with pytest.raises(OptimizerError, match="speed"):
        request_of(3, speed, 1.0)


@pytest.mark.parametrize("power", [0.0, -1.0, math.nan, math.inf])
def test_a_power_that_is_none_is_refused(power):
    with pytest.raises(OptimizerError, match="power"):
        request_of(4, 1.0, power)


def test_values_that_an_objective_does_not_use_do_not_matter():
    assert request_of(1, math.nan, -1.0).objective is Objective.CRUISE


def test_an_unknown_objective_is_refused_with_those_there_are():
    with pytest.raises(OptimizerError, match="9 is none of 0 MIN_POWER, 1 CRUISE"):
        request_of(9, 0.0, 0.0)


ABSENT = {1: GaitAnswer(RequestStatus.COMPUTING, "the front is being computed, 40 % done")}


def test_requests_are_answered_from_the_front_of_their_direction():
    fronts = {1: made_up_front(1), -1: made_up_front(-1)}
    told = answer(fronts, {}, -1, request_of(2, 0.0, 0.0))
    assert told.status is RequestStatus.DONE
    assert told.prediction is not None
    assert told.prediction.direction == -1
    assert "margin 3.40 mm" in told.message


def test_without_a_front_the_reason_is_told():
    assert answer({}, ABSENT, 1, request_of(1, 0.0, 0.0)) == ABSENT[1]


def test_a_direction_that_is_none_is_refused():
    told = answer({1: made_up_front()}, ABSENT, 0, request_of(1, 0.0, 0.0))
    assert told.status is RequestStatus.INVALID
    assert "direction: 0 is neither" in told.message


def test_a_refusal_carries_the_nearest_gait():
    told = answer({1: made_up_front()}, ABSENT, 1, request_of(3, 1.0, 0.0))
    assert told.status is RequestStatus.UNREACHABLE
    assert told.prediction is not None
    assert told.prediction.speed == 0.008
