# SPDX-License-Identifier: Apache-2.0
"""One page holds control at a time, and a page that falls silent holds nothing."""

import pytest

from worm_optimizer.console.control import SILENCE_S, Control


class Clock:
    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def control(clock: Clock) -> Control:
    control = Control(clock)
    control.beat("desk")
    control.beat("phone")
    return control


def test_the_first_who_asks_has_it_and_the_second_asks_for_it(control: Control):
    assert control.take("desk")
    assert not control.take("phone")
    assert (control.holder, control.asking) == ("desk", "phone")
    assert control.held


def test_it_is_handed_over_by_its_holder_alone(control: Control):
    control.take("desk")
    control.take("phone")
    control.hand_over("phone")
    assert control.is_held_by("desk")
    control.hand_over("desk")
    assert control.is_held_by("phone")
    assert control.asking == ""


def test_nothing_is_handed_over_where_nobody_asks(control: Control):
    control.take("desk")
    control.hand_over("desk")
    assert control.is_held_by("desk")


def test_a_silent_page_holds_nothing_and_another_may_take_it(control: Control, clock: Clock):
    control.take("desk")
    clock.now += SILENCE_S + 0.1
    assert not control.held
    control.beat("phone")
    assert control.take("phone")
    assert control.held


def test_a_page_that_beats_keeps_it(control: Control, clock: Clock):
    control.take("desk")
    for _ in range(5):
        clock.now += SILENCE_S - 0.1
        control.beat("desk")
        assert control.held


def test_a_page_that_never_beat_is_not_wanted_by_anybody(clock: Clock):
    control = Control(clock)
    assert control.take("new")
    assert not control.held


def test_a_closed_page_lets_go(control: Control):
    control.take("desk")
    control.take("phone")
    control.release("phone")
    assert control.asking == ""
    control.release("desk")
    assert control.holder == ""
    assert not control.held


def test_why_no_page_has_control_is_told(control: Control, clock: Clock):
    assert control.loss == "no page holds control"
    control.take("desk")
    assert control.loss == ""
    clock.now += SILENCE_S + 0.1
    assert control.loss == "the page in control was not heard for 3 s"
