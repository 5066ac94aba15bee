# SPDX-License-Identifier: Apache-2.0
"""Client of one goal of an action, from the request to its result."""

from __future__ import annotations

import math
import time
import uuid
from typing import Any

from rclpy.action import ActionClient
from rclpy.node import Node
from rclpy.task import Future
from unique_identifier_msgs.msg import UUID

from worm_msgs.goal_rejections import REJECTIONS_QOS, rejections_topic
from worm_msgs.msg import GoalRejection

REASON_S = 2.0  # longest time from a rejection to the message with its reason, s


class ActionGoal:
    """Goal of an action. Only the thread that spins the node may use it. No call blocks.

    Args:
        node: the client's node.
        kind: type of the action.
        name: name of the action.
        goal: the goal message.

    Attributes:
        name: name of the action.
        rejected: True if the server rejected the goal.
        reason: reason of the rejection; empty until it arrives.
        received_at: time of the latest feedback, s (monotonic clock); before the first feedback, time at
            which this object was created.
    """

    def __init__(self, node: Node, kind: Any, name: str, goal: Any) -> None:
        self.name = name
        self.rejected = False
        self.reason = ""
        self.received_at = time.monotonic()
        self._node = node
        self._client = ActionClient(node, kind, name)
        self._goal = goal
        self._id = UUID(uuid=list(uuid.uuid4().bytes))
        self._handle: Any = None
        self._ended: Future | None = None
        self._cancelled = False
        self._rejected_at = math.inf
        self._rejections = node.create_subscription(
            GoalRejection, rejections_topic(name), self._on_rejection, REJECTIONS_QOS
        )

    @property
    def possible(self) -> bool:
        """True if the action has a server."""
        return bool(self._client.server_is_ready())

    def send(self) -> None:
        """Send the goal."""
        sent = self._client.send_goal_async(self._goal, self._on_feedback, goal_uuid=self._id)
        sent.add_done_callback(self._on_answer)

    @property
    def answered(self) -> bool:
        """True if the goal was accepted or rejected."""
        return self.rejected or self._ended is not None

    @property
    def done(self) -> bool:
        """True when the result or the reason of a rejection has arrived, or `REASON_S` after a rejection."""
        if self.rejected:
            return bool(self.reason) or time.monotonic() > self._rejected_at + REASON_S
        return self._ended is not None and self._ended.done()

    @property
    def rejection(self) -> str:
        """Message about the rejection. It contains the reason or, if that is unknown, refers to the server's log."""
        return (
            f"rejected: {self.reason or f'see the log of the server of {self.name} for the reason'}"
        )

    def cancel(self) -> None:
        """Cancel the goal. A goal that is not accepted yet is cancelled as soon as the server accepts it."""
        self._cancelled = True
        if self._handle is not None:
            self._handle.cancel_goal_async()

    def close(self) -> None:
        """Free the client and the subscription, which would otherwise remain in the ROS graph."""
        self._node.destroy_subscription(self._rejections)
        self._client.destroy()

    def _message(self) -> Any:
        """Return the result message of an accepted goal that has ended."""
        assert self._ended is not None
        return self._ended.result().result

    def _on_answer(self, sent: Future) -> None:
        handle = sent.result()
        if not handle.accepted:
            self.rejected, self._rejected_at = True, time.monotonic()
            return
        self._handle = handle
        self._ended = self._handle.get_result_async()
        if self._cancelled:  # before the goal had a handle
            self._handle.cancel_goal_async()

    def _on_rejection(self, message: GoalRejection) -> None:
        if bytes(message.goal) == bytes(self._id.uuid):
            self.reason = message.reason

    def _on_feedback(self, message: Any) -> None:
        self.received_at = time.monotonic()
        self._take(message.feedback)

    def _take(self, feedback: Any) -> None:
        """Process a feedback message. The default ignores it, because the optimizer's actions send no feedback."""
