# SPDX-License-Identifier: Apache-2.0
"""The time of a bag during its playback."""

import math

from hypothesis import given
from hypothesis import strategies as st

from worm_model.bags.operations.play_clock import Timeline

TIMES = st.floats(0.0, 1e5)
RATES = st.floats(0.01, 1e3)


@given(start=st.integers(0, 2**60), wall=TIMES, later=TIMES, rate=RATES)
def test_it_runs_at_its_rate(start: int, wall: float, later: float, rate: float):
    timeline = Timeline(start, wall, rate)
    assert timeline.at(wall) == start
    assert timeline.at(wall + later) - start == round((wall + later - wall) * rate * 1e9)


@given(wall=TIMES, pause=TIMES, hold=TIMES, run=TIMES, rate=RATES)
def test_a_pause_takes_no_time_of_the_bag(wall, pause, hold, run, rate):
    timeline = Timeline(0, wall, rate)
    paused = timeline.pause(wall + pause)
    assert paused.at(wall + pause + hold) == timeline.at(wall + pause)
    assert paused.wall_at(10**9) == math.inf
    resumed = paused.resume(wall + pause + hold)
    gained = resumed.at(wall + pause + hold + run) - paused.bag_ns
    assert abs(gained - run * rate * 1e9) <= 1 + 1e-6 * rate * 1e9


@given(ahead=st.integers(0, 10**13), wall=TIMES, rate=RATES)
def test_the_wall_time_of_a_bag_time_is_when_it_is_reached(ahead: int, wall: float, rate: float):
    timeline = Timeline(500, wall, rate)
    reached = timeline.at(timeline.wall_at(500 + ahead))
    assert abs(reached - 500 - ahead) <= 2 + 1e-9 * rate * 1e9


def test_a_jump_keeps_rate_and_pause():
    timeline = Timeline(0, 0.0, 2.0, paused=True).jump(7, 3.0)
    assert (timeline.at(100.0), timeline.rate, timeline.paused) == (7, 2.0, True)
