# SPDX-License-Identifier: Apache-2.0
"""Lost messages are counted, whatever the publishers do."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("rclpy", reason="no ROS is installed")
from worm_model.nodes.raw_subscriptions import LossCounter


def observe(sequences: list[int], publishers: int = 1) -> int:
    counter = LossCounter(lambda: publishers)
    for sequence in sequences:
        counter.observe(sequence)
    return counter.lost


@given(st.sets(st.integers(1, 60), min_size=1))
def test_the_gaps_of_one_publisher_are_its_losses(received: set[int]):
    ordered = sorted(received)
    assert observe(ordered) == ordered[-1] - ordered[0] + 1 - len(ordered)


@given(st.lists(st.sets(st.integers(2, 40)), min_size=2, max_size=4), st.randoms())
def test_losses_of_several_publishers_add_up(received, draw):
    """Losses are complete when another message of every publisher has arrived: here, the hundredth."""
    streams = [[*sorted(numbers), 100] for numbers in received]
    expected = sum(99 - len(stream) for stream in streams)
    sequences = [1] * len(streams)
    while any(streams):
        stream = draw.choice([s for s in streams if s])
        sequences.append(stream.pop(0))
    assert observe(sequences, publishers=len(received)) == expected


def test_a_publisher_that_started_earlier_has_lost_nothing():
    assert observe([500, 501, 502]) == 0


def test_a_second_publisher_that_is_far_ahead_has_lost_nothing():
    publishers = 1
    counter = LossCounter(lambda: publishers)
    counter.observe(1)
    publishers = 2
    for sequence in (5000, 2, 5001):
        counter.observe(sequence)
    assert counter.lost == 0


def test_a_restarted_publisher_has_lost_nothing():
    assert observe([1, 2, 3, 1, 2]) == 0
