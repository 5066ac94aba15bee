# SPDX-License-Identifier: Apache-2.0
"""The snapshot of a robot's topics; the subscribing node is a fake."""

import math
from collections.abc import Callable
from typing import Any

import pytest
from builtin_interfaces.msg import Time
from std_msgs.msg import Header

from worm_msgs.msg import BodyLength, Tracker, TwinState
from worm_optimizer.nodes.robot_telemetry import Telemetry


class Node:
    """Fake node that passes messages on, by topic."""

    def __init__(self) -> None:
        self.publish: dict[str, Callable[[Any], None]] = {}

    def create_subscription(
        self, kind: type, topic: str, callback: Callable[[Any], None], qos: object
    ) -> None:
        self.publish[topic] = callback


def test_the_twin_is_as_old_as_its_state_relative_to_the_newest_measurement():
    """An inactive driver publishes no command, while the tracker continues and the twin with it."""
    node = Node()
    telemetry = Telemetry(node)
    telemetry.subscribe_to_all()
    node.publish["twin/state"](TwinState(header=Header(stamp=Time(sec=7, nanosec=600_000_000))))
    assert math.isnan(telemetry.snapshot().twin_age)
    node.publish["body_length/commanded"](BodyLength(header=Header(stamp=Time(sec=8))))
    assert telemetry.snapshot().twin_age == pytest.approx(0.4)
    node.publish["tracker"](Tracker(header=Header(stamp=Time(sec=20))))
    node.publish["twin/state"](TwinState(header=Header(stamp=Time(sec=19, nanosec=500_000_000))))
    assert telemetry.snapshot().twin_age == pytest.approx(0.5)
