# SPDX-License-Identifier: Apache-2.0
"""Odometry of the twin, and the transform with the same content."""

import math

import numpy as np
import pytest

pytest.importorskip("nav_msgs", reason="no ROS is installed")

from worm_model.nodes.twin_messages import UNMEASURED, odometry, transform
from worm_model.twin.data.records import STATE_ROW


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
