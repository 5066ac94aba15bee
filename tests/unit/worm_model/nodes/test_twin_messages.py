# SPDX-License-Identifier: Apache-2.0
"""Odometry of the twin, the transform with the same content, and the markers of robot and twin."""

import math

import numpy as np
import pytest

pytest.importorskip("nav_msgs", reason="no ROS is installed")
pytest.importorskip("visualization_msgs", reason="no ROS is installed")

from worm_model.nodes.twin_markers import markers
from worm_model.nodes.twin_messages import UNMEASURED, odometry, transform
from worm_model.parameters import PAPER
from worm_model.run import LengthSource
from worm_model.twin.data.records import STATE_ROW, StateRecord
from worm_model.twin.scene import PositionSample


def test_odometry_is_the_state_with_the_deviation_of_the_position():
    row = np.zeros(1, STATE_ROW)[0]
    row["stamp_ns"], row["rear_position"], row["rear_velocity"] = 5_000_000_007, 0.3, 0.02
    message = odometry(row, 0.002)
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (5, 7)
    assert message.twist.twist.linear.x == 0.02
    assert message.pose.covariance[0] == pytest.approx(4e-6)
    diagonal = message.pose.covariance.reshape(6, 6).diagonal()
    assert diagonal[1:].tolist() == [UNMEASURED] * 5
    assert odometry(row, math.nan).pose.covariance[0] == UNMEASURED
    sent = transform(message)
    assert sent.header == message.header
    assert sent.child_frame_id == message.child_frame_id
    assert sent.transform.translation.x == message.pose.pose.position.x == 0.3
    assert sent.transform.rotation.w == 1.0


STAMP = 10**18


def drawn(robot: PositionSample) -> dict:
    values = dict.fromkeys(StateRecord.__dataclass_fields__, 0.0)
    values |= {"stamp_ns": STAMP, "length_source": LengthSource.MEASURED, "front_position": 0.3}
    state = StateRecord(**values | {"front_anchor": 0.2941})
    return {marker.ns: marker for marker in markers(state, robot, PAPER, 1).markers}


def test_robot_and_ghost_are_drawn_on_the_pipes_lattice():
    found = drawn(PositionSample(0.01, 0.31, STAMP))
    assert found["robot rear module"].pose.position.x == 0.01
    assert found["twin front module"].pose.position.x == 0.3
    ridges = sorted({point.x for point in found["pipe ridges"].points})
    assert np.diff(ridges) == pytest.approx(PAPER.pitch)
    assert ridges[0] % PAPER.pitch == pytest.approx(PAPER.pitch / 2)


@pytest.mark.parametrize(
    "robot",
    [
        PositionSample(),
        PositionSample(0.01, math.nan, STAMP),
        PositionSample(0.01, 0.31, STAMP - 1_100_000_000),
        PositionSample(0.01, 0.31, STAMP + 1_100_000_000),
    ],
)
def test_a_robot_that_is_not_measured_is_not_drawn(robot: PositionSample):
    found = drawn(robot)
    assert "twin rear module" in found
    assert not any(name.startswith("robot") for name in found)
