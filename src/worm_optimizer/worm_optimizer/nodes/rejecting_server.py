# SPDX-License-Identifier: Apache-2.0
"""Action server that logs and publishes the reasons for which it rejects goals."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.action import ActionServer, GoalResponse
from rclpy.node import Node

from worm_msgs.goal_rejections import GoalRejections


class RejectingServer(ActionServer):
    """Action server that publishes the reason of each rejection.

    Args:
        node: the server's node.
        kind: type of the action.
        name: name of the action.
        execute: callback that executes an accepted goal.
        why_not: returns the reason to reject a goal, or an empty string to accept it.
        more: further arguments of ActionServer.
    """

    def __init__(
        self,
        node: Node,
        kind: Any,
        name: str,
        execute: Callable[..., Any],
        why_not: Callable[[Any], str],
        **more: Any,
    ) -> None:
        self._why_not, self._goal_id = why_not, b""
        self._log = node.get_logger()
        self._rejections = GoalRejections(node, name, lambda: node.get_clock().now().to_msg())
        super().__init__(node, kind, name, execute, goal_callback=self._on_goal, **more)

    async def _execute_goal_request(self, request: tuple[Any, Any]) -> None:
        self._goal_id = bytes(request[1].goal_id.uuid)  # rclpy does not pass it to the callback
        await super()._execute_goal_request(request)

    def _on_goal(self, goal: Any) -> GoalResponse:
        reason = self._why_not(goal)
        if not reason:
            return GoalResponse.ACCEPT
        self._log.warning(f"goal rejected: {reason}")
        self._rejections.publish(self._goal_id, reason)
        return GoalResponse.REJECT
