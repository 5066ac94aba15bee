# SPDX-License-Identifier: Apache-2.0
"""Faults as text, their defaults, and their times."""

import math

import pytest

from worm_driver.virtual_robot.wire.faults import (
    KINDS,
    Fault,
    FaultBoard,
    FaultError,
    make_fault,
    parse_fault,
)


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("late", Fault("late", None, 0.0, math.inf, 1, 0.045)),
        ("late:target=1,value=0.1,count=3@2.5", Fault("late", 1, 2.5, math.inf, 3, 0.1)),
        ("no_answer:duration=0.5", Fault("no_answer", None, 0.0, 0.5, 0, 0.0)),
        ("unplugged@4", Fault("unplugged", None, 4.0, 1.0, 0, 0.0)),
        ("error:value=7", Fault("error", None, 0.0, math.inf, 1, 7.0)),
    ],
)
def test_faults_as_text(text, fault):
    assert parse_fault(text) == fault


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("fire", "no fault 'fire': choose one of no_answer"),
        ("late@soon", "write NAME"),
        ("late:value", "write NAME"),
        ("late:depth=3", "no option 'depth'"),
        ("late@-1", "must not be negative"),
        ("late:value=nan", "finite"),
        ("error:value=8", "error number from 1 to 7"),
        ("error:value=1.5", "error number from 1 to 7"),
    ],
)
def test_invalid_values_are_rejected(text, expected):
    with pytest.raises(FaultError, match=expected):
        parse_fault(text)


@pytest.mark.parametrize("name", KINDS)
def test_every_kind_can_be_requested_by_its_name_alone(name):
    fault = make_fault(name)
    assert fault.count > 0 or fault.duration < math.inf


def test_a_fault_strikes_its_target_in_its_time():
    board = FaultBoard([make_fault("stalled", target=1, start=1.0, duration=2.0)])
    struck = [time for time in (0.9, 1.0, 3.0, 3.1) if board.active("stalled", time, 1)]
    assert struck == [1.0, 3.0]
    assert board.active("stalled", 2.0, 2) is None
    assert board.active("vanished", 2.0, 1) is None


def test_a_count_is_used_up_and_a_duration_is_not():
    board = FaultBoard([make_fault("no_answer", count=2)])
    assert [bool(board.consume("no_answer", 0.0, 1)) for _ in range(3)] == [True, True, False]
    board = FaultBoard([make_fault("no_answer", duration=1.0)])
    assert all(board.consume("no_answer", time, 1) for time in (0.0, 0.5, 1.0))


def test_past_faults_are_forgotten_and_all_can_be_cleared():
    board = FaultBoard([make_fault("stalled", duration=1.0), make_fault("late")])
    board.forget_past(2.0)
    assert board.active("stalled", 0.5, 1) is None
    board.clear()
    assert board.active("late", 0.5, 1) is None
