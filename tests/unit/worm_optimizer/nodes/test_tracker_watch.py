# SPDX-License-Identifier: Apache-2.0
"""A tracker that is lost during a campaign, and the messages about it."""

import math

import pytest

from worm_msgs.msg import Tracker
from worm_optimizer.nodes.robot_telemetry import TrackerWatch


class Desk:
    """Fake node with messages and a timer that the test triggers, at a time (s) that it sets."""

    def __init__(self) -> None:
        self.time = 0.0
        self.reported: list[str] = []
        TrackerWatch(self, lambda: self.time, self.reported.append)

    def create_subscription(self, _kind, topic, callback, _depth):
        assert topic == "tracker"
        self._on_message = callback

    def create_timer(self, _period, callback, clock):
        assert clock
        self._look = callback

    def until(self, time: float, position: float | None) -> None:
        while self.time < time:
            self.time += 0.1
            if position is not None:
                self._on_message(Tracker(rear_position=0.1, front_position=position))
            self._look()


@pytest.mark.parametrize(
    ("seen", "expected"),
    [(None, "no message of the tracker"), (math.nan, "does not see both modules")],
)
def test_a_loss_and_its_end_are_reported_once(seen, expected):
    desk = Desk()
    desk.until(3.0, 0.4)
    desk.until(4.5, seen)  # a marker that is covered briefly
    desk.until(5.0, 0.4)
    assert desk.reported == []
    desk.until(9.0, seen)
    assert len(desk.reported) == 1
    assert expected in desk.reported[0]
    desk.until(10.0, 0.4)
    assert desk.reported[1:] == ["the tracker is back after 4.1 s"]
