# SPDX-License-Identifier: Apache-2.0
"""Pages of two consoles and the driver's lease: one page has control, and a page that returns has none."""

from collections import deque

import pytest

from worm_driver.control.control_lease import ControlLease
from worm_driver.control.heartbeat import PERIOD
from worm_optimizer.console.control import ConsoleControl
from worm_optimizer.snapshot import Control, Wish

TIMEOUT_S = 5.0


class Bench:
    """Two consoles and one driver. Wishes and the driver's state arrive at the end of each step of time."""

    def __init__(self) -> None:
        self.now = 100.0
        self.lease = ControlLease()
        self.wishes: deque[tuple[str, Wish, float]] = deque()
        self.desk = self.console("desk:8080")
        self.lab = self.console("lab:8080")

    def console(self, name: str) -> ConsoleControl:
        return ConsoleControl(
            name, lambda: self.now, lambda *wish: self.wishes.append(wish), TIMEOUT_S
        )

    def deliver(self) -> None:
        while self.wishes:
            client, wish, lease = self.wishes.popleft()
            if wish is Wish.CONTROL:
                self.lease.request(client, lease, self.now)
            elif wish is Wish.HAND_OVER:
                self.lease.hand_over(client)
            else:
                self.lease.release(client)
        self.lease.expire(self.now)
        for console in (self.desk, self.lab):
            console.update(Control(self.lease.holder, self.lease.requester))

    def pass_time(self, duration_s: float, *alive: tuple[ConsoleControl, str]) -> None:
        for _ in range(round(duration_s / PERIOD)):
            self.now += PERIOD
            for console, page in alive:
                console.on_message(page)
            self.deliver()


@pytest.fixture
def bench() -> Bench:
    return Bench()


@pytest.fixture
def held(bench: Bench) -> Bench:
    """Page a of the desk has control, and a run was started for it."""
    bench.desk.request("a")
    bench.deliver()
    bench.desk.begin_run()
    return bench


def test_no_page_has_control_before_the_driver_grants_it(bench: Bench):
    bench.desk.request("a")
    assert not bench.desk.is_held_by("a")
    assert bench.desk.is_requested_by("a")
    bench.deliver()
    assert bench.desk.is_held_by("a")


def test_one_page_of_all_consoles_has_control(held: Bench):
    held.lab.request("b")
    held.desk.request("c")
    held.deliver()
    assert held.desk.is_held_by("a")
    assert not held.lab.is_held_by("b")
    assert (held.lab.holder, held.desk.holder) == ("a page of desk:8080", "another page")
    assert held.desk.requester == "a page of lab:8080"


def test_a_run_goes_on_when_control_is_handed_over(held: Bench):
    held.lab.request("b")
    held.deliver()
    held.desk.hand_over("a")
    held.deliver()
    assert held.lab.is_held_by("b")
    assert not held.desk.is_held_by("a")
    assert held.desk.loss_of("a") == ""
    assert held.desk.run_loss == ""


def test_a_run_ends_when_its_page_is_closed_although_another_page_obtains_control(held: Bench):
    held.lab.request("b")
    held.deliver()
    held.desk.forget("a")
    held.deliver()
    assert held.lab.is_held_by("b")
    assert "a page of lab:8080" in held.desk.run_loss


def test_a_silent_page_loses_control_and_its_run_ends(held: Bench):
    held.pass_time(TIMEOUT_S - 2.0 * PERIOD)
    assert held.desk.run_loss == ""
    held.pass_time(3.0 * PERIOD)
    assert not held.desk.is_held_by("a")
    assert held.desk.run_loss


def test_a_page_that_comes_back_has_no_control_and_shows_why(held: Bench):
    held.now += TIMEOUT_S + PERIOD
    held.desk.on_message("a")
    held.deliver()
    held.pass_time(2.0 * TIMEOUT_S, (held.desk, "a"))
    assert not held.desk.is_held_by("a")
    assert "silent" in held.desk.loss_of("a")
    held.desk.request("a")
    held.deliver()
    assert held.desk.is_held_by("a")


def test_a_page_whose_console_lost_the_driver_does_not_obtain_control_by_itself(held: Bench):
    held.desk.update(None)
    held.pass_time(TIMEOUT_S + 2.0 * PERIOD, (held.desk, "a"))
    assert not held.desk.is_held_by("a")
    assert held.lease.holder == ""
    assert held.desk.loss_of("a")


def test_a_page_that_sends_messages_keeps_control(held: Bench):
    held.pass_time(5.0 * TIMEOUT_S, (held.desk, "a"), (held.lab, "b"))
    assert held.desk.is_held_by("a")
    assert held.desk.run_loss == ""


def test_release_and_withdrawal(held: Bench):
    held.lab.request("b")
    held.deliver()
    held.lab.release("b")
    held.deliver()
    assert held.desk.requester == ""
    held.desk.release("a")
    held.deliver()
    assert held.lease.holder == ""
    assert held.desk.run_loss
    assert held.desk.loss_of("a") == ""


def test_a_page_without_control_changes_nothing(held: Bench):
    held.desk.hand_over("c")
    held.desk.release("c")
    held.desk.forget("c")
    held.deliver()
    assert held.desk.is_held_by("a")
