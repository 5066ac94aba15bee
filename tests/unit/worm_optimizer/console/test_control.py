# SPDX-License-Identifier: Apache-2.0
"""One page at a time has control, and a run ends when its page has lost it."""

import pytest

from worm_optimizer.console.control import PageControl

TIMEOUT_S = 5.0


class Bench:
    def __init__(self) -> None:
        self.now = 100.0
        self.control = PageControl(lambda: self.now, TIMEOUT_S)

    def pass_time(self, duration_s: float, *alive: str) -> None:
        for _ in range(round(2.0 * duration_s)):
            self.now += 0.5
            for page in alive:
                self.control.on_message(page)
            self.control.expire()


@pytest.fixture
def held() -> Bench:
    """Page a has control, and a run was started for it."""
    bench = Bench()
    bench.control.request("a")
    bench.control.begin_run()
    return bench


def test_without_a_page_no_run_continues():
    control = Bench().control
    assert control.run_loss
    assert not control.is_held_by("")


def test_the_first_page_has_control_while_it_is_alive(held: Bench):
    held.pass_time(20.0, "a", "b")
    for page in ("b", "c"):
        held.control.request(page)
    assert held.control.is_held_by("a")
    assert held.control.requester == "b"  # only one page waits
    assert held.control.run_loss == ""
    held.control.release("b")
    assert held.control.requester == ""


def test_a_run_continues_under_the_page_to_which_control_is_handed(held: Bench):
    held.control.request("b")
    held.control.hand_over("b")  # only the page that has control can hand it over
    assert held.control.is_held_by("a")
    held.control.hand_over("a")
    assert held.control.is_held_by("b")
    assert held.control.run_loss == ""
    assert held.control.loss_of("a") == ""


@pytest.mark.parametrize("waits", [False, True])
def test_a_released_run_ends_even_if_another_page_then_has_control(held: Bench, waits: bool):
    if waits:
        held.control.request("b")
    held.control.release("a", "why")
    assert held.control.is_held_by("b") == waits
    assert held.control.loss_of("a") == "why"
    assert held.control.run_loss


def test_a_silent_page_loses_control_and_does_not_get_it_back_by_returning(held: Bench):
    held.pass_time(TIMEOUT_S, "b")
    assert held.control.is_held_by("a")
    held.now += 0.5
    assert held.control.run_loss  # at once, before the next call of expire
    held.control.on_message("a")
    assert not held.control.is_held_by("a")
    assert "silent" in held.control.loss_of("a")
    held.control.request("b")
    assert held.control.is_held_by("b")


def test_the_request_of_a_silent_page_ends(held: Bench):
    held.control.request("b")
    held.pass_time(TIMEOUT_S + 1.0, "a")
    assert held.control.requester == ""
    assert held.control.is_held_by("a")


def test_a_closed_page_ends_its_run(held: Bench):
    held.control.forget("a")
    assert held.control.holder == ""
    assert held.control.run_loss
