# SPDX-License-Identifier: Apache-2.0
"""Advance of the robot's time, with a machine's time that the test sets."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from worm_driver.simulated_clock import I2C, SERIAL, Wait
from worm_driver.virtual_robot.wire.clock_server import ClockClient, ClockServer


def keeper(rate: float = 1.0) -> ClockServer:
    made = ClockServer(rate)
    made.begin(100.0)
    return made


def test_alone_it_goes_with_the_machine():
    time = keeper()
    assert time.alone(101.5) == pytest.approx(1.5)
    assert time.alone(101.0) == pytest.approx(1.5)  # never backwards


def test_it_catches_up_with_a_small_delay_and_drops_the_rest():
    time = keeper()
    time.together(100.0, [True], until=0.01)
    time.together(103.0, [False], until=0.01)  # a client took three seconds
    assert time.now == 0.0
    assert time.together(103.0, [True], until=5.0) == pytest.approx(0.1)


def test_as_fast_as_possible_it_goes_from_event_to_event():
    time = keeper(math.inf)
    for event in (0.5, 0.7, 30.0):
        assert time.together(100.0, [True], until=event) == event
    assert time.machine_time(31.0) == 100.0
    time.begin(100.0)
    # without clients, time advances with the machine's again
    assert time.alone(101.0) == pytest.approx(31.0)


def test_at_another_rate_it_goes_by_that():
    time = keeper(4.0)
    assert time.machine_time(2.0) == pytest.approx(100.5)
    assert time.together(100.01, [True], until=math.inf) == pytest.approx(0.04)


@given(
    steps=st.lists(
        st.tuples(st.floats(0.0, 5.0), st.booleans(), st.floats(0.0, 0.02)), min_size=1, max_size=60
    ),
    rate=st.sampled_from([0.5, 1.0, 20.0, math.inf]),
)
def test_whatever_the_machine_does_no_event_is_passed_and_time_never_goes_back(steps, rate):
    time, machine, event = keeper(rate), 100.0, 0.0
    for pause, waits, ahead in steps:
        machine += pause
        before, event = time.now, time.now + ahead
        now = time.together(machine, [waits], event)
        assert before <= now <= event
        assert waits or now == before


def test_bytes_on_their_way_keep_the_time():
    client = ClockClient(SERIAL, Wait(1, 0.1, True, written=14, read=60), since=5.0)
    assert client.waits(sent=60, received=14)
    assert not client.waits(sent=60, received=13)  # a request that has not arrived
    assert not client.waits(sent=61, received=14)  # a response that has not arrived
    assert ClockClient(SERIAL, Wait(1, 0.1, False, 14, 60)).waits(
        sent=61, received=14
    )  # nor is awaited
    assert not ClockClient(SERIAL).waits(0, 0)
    assert ClockClient(I2C, Wait(1, 0.1, False, 0, 0)).waits(sent=61, received=14)


@pytest.mark.parametrize(("sent", "received"), [(60, 13), (61, 14)])
def test_bytes_that_stay_in_transit_for_long_are_lost(sent, received):
    client = ClockClient(SERIAL, Wait(1, 0.1, True, written=14, read=60), since=5.0)
    assert not client.has_lost_bytes(5.1, sent, received)
    assert client.has_lost_bytes(60.0, sent, received)


@pytest.mark.parametrize(
    "client",
    [
        ClockClient(SERIAL, Wait(1, 0.1, True, written=14, read=60), since=5.0),
        ClockClient(SERIAL, Wait(1, 0.1, False, written=14, read=50), since=5.0),
        ClockClient(SERIAL),
        ClockClient(I2C, Wait(1, 0.1, True, 0, 0), since=5.0),
    ],
    ids=["idle", "idle without listening", "computes", "of the I2C bus"],
)
def test_a_client_without_bytes_in_transit_has_lost_none_however_long_it_waits(client):
    assert not client.has_lost_bytes(60.0, sent=60, received=14)
