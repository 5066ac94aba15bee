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


@pytest.mark.parametrize(
    ("sequences", "publishers"),
    [
        ([500, 501, 502], 1),  # the publisher started earlier
        ([1, 2, 3, 1, 2], 1),  # it restarted
        ([1, 5000, 2, 5001], 2),  # a second one is far ahead
    ],
)
def test_nothing_was_lost(sequences: list[int], publishers: int):
    assert observe(sequences, publishers) == 0
