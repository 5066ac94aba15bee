# SPDX-License-Identifier: Apache-2.0
"""Topic with the reasons of rejected goals. The response of ROS 2 to a goal has no field for a reason."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile

from worm_msgs.msg import GoalRejection

#: Latched, so that a client also receives a rejection that was published before the publisher discovered the client.
REJECTIONS_QOS = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def rejections_topic(action: str) -> str:
    """Return the topic on which the reasons of an action's rejections are published."""
    return f"{action}/rejections"


class GoalRejections:
    """Publisher of the reasons of an action's rejections. ``now`` returns the present stamp."""

    def __init__(self, node: Node, action: str, now: Callable[[], Any]) -> None:
        self._now = now
        self._publisher = node.create_publisher(
            GoalRejection, rejections_topic(action), REJECTIONS_QOS
        )

    def publish(self, goal_id: bytes, reason: str) -> None:
        """Publish why a goal is rejected. Safe in any thread."""
        rejection = GoalRejection(goal=list(goal_id), reason=reason)
        rejection.header.stamp = self._now()
        self._publisher.publish(rejection)
