# SPDX-License-Identifier: Apache-2.0
"""One client has control at a time, and loses it if it stops sending."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from worm_driver.control.control_lease import MAX_LEASE, ControlLease
from worm_driver.control.heartbeat import PERIOD

LEASE = 5.0


class Bench:
    """Lease whose time advances in steps of PERIOD."""

    def __init__(self) -> None:
        self.lease = ControlLease()
        self.now = 100.0

    def request(self, *clients: str) -> None:
        for client in clients:
            self.lease.request(client, LEASE, self.now)

    def pass_time(self, duration_s: float, *alive: str) -> None:
        for _ in range(round(duration_s / PERIOD)):
            self.now += PERIOD
            self.request(*alive)
            self.lease.expire(self.now)

    @property
    def state(self) -> tuple[str, str]:
        return self.lease.holder, self.lease.requester


@pytest.fixture
def bench() -> Bench:
    return Bench()


def test_the_first_client_has_control_and_the_second_requests_it(bench: Bench):
    bench.request("desk", "phone", "tablet")
    assert bench.state == ("desk", "phone")


def test_only_the_holder_hands_over(bench: Bench):
    bench.request("desk", "phone")
    bench.lease.hand_over("phone")
    bench.lease.hand_over("tablet")
    assert bench.state == ("desk", "phone")
    bench.lease.hand_over("desk")
    assert bench.state == ("phone", "")
    bench.lease.hand_over("phone")
    assert bench.state == ("phone", "")


def test_a_client_that_repeats_its_request_keeps_control(bench: Bench):
    bench.request("desk")
    bench.pass_time(10.0 * LEASE, "desk")
    assert bench.state == ("desk", "")


def test_a_silent_holder_loses_control_to_the_requester(bench: Bench):
    bench.request("desk", "phone")
    bench.pass_time(LEASE + 2.0 * PERIOD, "phone")
    assert bench.state == ("phone", "")


def test_a_silent_requester_is_forgotten(bench: Bench):
    bench.request("desk", "phone")
    bench.pass_time(LEASE + 2.0 * PERIOD, "desk")
    assert bench.state == ("desk", "")


def test_time_in_which_the_driver_was_late_is_no_silence(bench: Bench):
    bench.request("desk")
    bench.lease.expire(bench.now)
    bench.now += 10.0 * LEASE
    bench.lease.expire(bench.now)
    assert bench.state == ("desk", "")


def test_release_by_requester_and_holder(bench: Bench):
    bench.request("desk", "phone")
    bench.lease.release("phone")
    assert bench.state == ("desk", "")
    bench.lease.release("desk")
    assert bench.state == ("", "")


def test_each_client_loses_control_after_its_own_lease(bench: Bench):
    bench.lease.request("desk", 2.0 * LEASE, bench.now)
    bench.pass_time(1.5 * LEASE)
    assert bench.state == ("desk", "")
    bench.pass_time(LEASE)
    assert bench.state == ("", "")


@pytest.mark.parametrize("lease", [0.0, -1.0, math.nan, math.inf, 1.01 * MAX_LEASE])
def test_a_lease_without_end_is_rejected(bench: Bench, lease: float):
    with pytest.raises(ValueError, match="lease_s"):
        bench.lease.request("desk", lease, bench.now)
    assert bench.state == ("", "")


def test_a_client_without_a_name_changes_nothing(bench: Bench):
    bench.request("", "desk")
    bench.lease.release("")
    bench.lease.hand_over("")
    assert bench.state == ("desk", "")


@given(
    st.lists(
        st.tuples(
            st.sampled_from(["request", "hand_over", "release", "wait"]), st.sampled_from("abc")
        )
    )
)
def test_holder_and_requester_are_two_clients_and_both_end_in_silence(actions):
    bench = Bench()
    for action, client in actions:
        if action == "wait":
            bench.pass_time(2.0 * PERIOD)
        elif action == "request":
            bench.request(client)
        else:
            getattr(bench.lease, action)(client)
        holder, requester = bench.state
        assert holder != requester or not holder
        assert holder or not requester
    bench.pass_time(LEASE + 2.0 * PERIOD)
    assert bench.state == ("", "")
