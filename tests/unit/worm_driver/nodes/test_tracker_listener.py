# SPDX-License-Identifier: Apache-2.0
"""The driver's subscription to the tracker, without the middleware."""

import math
from unittest.mock import MagicMock

import pytest

pytest.importorskip("worm_msgs", reason="the workspace is not built")

from worm_driver.nodes.tracker_listener import TrackerListener
from worm_msgs.msg import Tracker


@pytest.mark.parametrize("far", [1e308, -1e308, math.inf, math.nan])
def test_a_position_that_no_pipe_has_counts_as_hidden(far):
    stamps, seen = MagicMock(), []
    stamps.monotonic.side_effect = [0.01 * index for index in range(200)]
    listener = TrackerListener(MagicMock(), stamps, lambda _, position: seen.append(position))
    for index in range(200):
        wrong = far * (-1) ** index
        listener._on_sample(Tracker(rear_position=wrong, front_position=wrong))
    assert all(map(math.isnan, seen))
    assert not listener._stillness.lasts
