# SPDX-License-Identifier: Apache-2.0
"""Topic with the reasons why goals are rejected. The response of ROS 2 to a goal has no field for a reason."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile

from worm_msgs.msg import GoalRejection

#: Latched, so that a client also receives a rejection that was published before the publisher discovered the client.
REJECTIONS_QOS = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def rejections_topic(action: str) -> str:
    """Return the name of the topic on which the reasons for the rejections of an action's goals are published."""
    return f"{action}/rejections"


class GoalRejections:
    """Publisher of the reasons why goals of an action are rejected.

    Args:
        node: node that publishes.
        action: name of the action.
        now: returns the present time as a ROS stamp.
    """

    def __init__(self, node: Node, action: str, now: Callable[[], Any]) -> None:
        self._now = now
        self._publisher = node.create_publisher(
            GoalRejection, rejections_topic(action), REJECTIONS_QOS
        )

    def publish(self, goal_id: bytes, reason: str) -> None:
        """Publish why the goal with an id (the 16 bytes of its UUID) is rejected. Safe in any thread."""
        rejection = GoalRejection(goal=list(goal_id), reason=reason)
        rejection.header.stamp = self._now()
        self._publisher.publish(rejection)
