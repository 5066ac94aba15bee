# SPDX-License-Identifier: Apache-2.0
"""The snapshot of a robot's topics; the subscribing node is a fake."""

import math
from collections.abc import Callable
from typing import Any

import pytest
from builtin_interfaces.msg import Time
from std_msgs.msg import Header

from worm_model.twin.data.records import STALE_S
from worm_msgs.msg import BodyLength, Tracker, TwinResiduals, TwinState
from worm_optimizer.nodes import robot_telemetry
from worm_optimizer.nodes.robot_telemetry import Telemetry

NAN = math.nan


class Node:
    """Fake node that passes messages on, by topic."""

    def __init__(self) -> None:
        self.publish: dict[str, Callable[[Any], None]] = {}

    def create_subscription(
        self, kind: type, topic: str, callback: Callable[[Any], None], qos: object
    ) -> None:
        self.publish[topic] = callback


def residuals(**measured: float) -> TwinResiduals:
    unmeasured = dict.fromkeys(("rear_position", "length", "power"), NAN)
    return TwinResiduals(**{**unmeasured, **measured}, health=TwinResiduals.HEALTHY)


def test_each_residual_is_that_of_the_last_sample_which_measured_it(
    monkeypatch: pytest.MonkeyPatch,
):
    node, now = Node(), 100.0
    monkeypatch.setattr(robot_telemetry.time, "monotonic", lambda: now)
    telemetry = Telemetry(node)
    telemetry.subscribe_to_all()
    assert telemetry.snapshot().residuals is None
    node.publish["twin/residuals"](residuals(rear_position=1e-3, length=2e-3))
    node.publish["twin/residuals"](residuals(power=0.5))
    shown = telemetry.snapshot().residuals
    assert shown is not None
    assert (shown.rear_position, shown.length, shown.power) == (1e-3, 2e-3, 0.5)
    now += 2.0 * STALE_S  # the tracker measures nothing, the power sensor does
    node.publish["twin/residuals"](residuals(power=0.25))
    shown = telemetry.snapshot().residuals
    assert shown is not None
    assert math.isnan(shown.rear_position)
    assert shown.power == 0.25


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
