# SPDX-License-Identifier: Apache-2.0
"""Plausibility of positions, given the fastest motion of a shaft."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from worm_driver.servos.position_track import PositionSample, PositionTrack, is_reachable

FASTEST = 4.8  # rad/s
TICKS_PER_S = FASTEST / math.tau * 4096


def watching(ticks: int = 0) -> PositionTrack:
    track = PositionTrack({1: FASTEST})
    track.begin({1: PositionSample(ticks, 0.0)})
    return track


@given(st.floats(0.0, 0.5), st.floats(-1.0, 1.0), st.integers(-(10**5), 10**5))
def test_the_fastest_motion_is_plausible_even_after_lost_cycles(elapsed, share, start):
    moved = round(share * TICKS_PER_S * elapsed)
    assert is_reachable(PositionSample(start, 1.0), start + moved, 1.0 + elapsed, FASTEST)


@pytest.mark.parametrize("jump", [-8192, -4096, -600, -300, 300, 600, 4096, 12288])
def test_a_jump_within_a_cycle_is_not(jump):
    track = watching(100)
    assert not track.record_if_plausible(1, 100 + jump, 0.01)
    assert track.last(1) == PositionSample(100, 0.0)
    # the next sample is judged by the one before the wrong one
    assert track.record_if_plausible(1, 105, 0.02)
    assert track.last(1) == PositionSample(105, 0.02)


def test_a_lost_position_does_not_become_plausible_by_waiting():
    track = watching()
    track.mark_lost(1, 600)
    assert not any(track.record_if_plausible(1, ticks, 1e6) for ticks in (0, 600))
    assert track.lost == {1: 600}
    track.begin({1: PositionSample(600, 1e6)})
    assert track.record_if_plausible(1, 601, 1e6 + 0.01)


def test_with_the_torque_off_a_person_may_turn_the_spool():
    track = watching()
    track.end()
    assert track.record_if_plausible(1, 5000, 0.01)


def test_a_clock_that_goes_back_allows_no_more():
    assert not is_reachable(PositionSample(0, 5.0), 500, 4.0, FASTEST)
