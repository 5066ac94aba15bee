# SPDX-License-Identifier: Apache-2.0
"""One goal of an action, from its being sent to its result."""

from __future__ import annotations

import time
import uuid
from typing import Any

from rclpy.action import ActionClient
from rclpy.node import Node
from rclpy.task import Future
from unique_identifier_msgs.msg import UUID


class ActionGoal:
    """Owned by whoever spins the node: no call waits.

    Attributes:
        name: of the action.
        heard_at: when the last word of it came (s, monotonic).
    """

    def __init__(self, node: Node, kind: Any, name: str, goal: Any) -> None:
        self.name = name
        self.heard_at = time.monotonic()
        self._node = node
        self._client = ActionClient(node, kind, name)
        self._goal = goal
        self._id = UUID(uuid=list(uuid.uuid4().bytes))
        self._handle: Any = None
        self._ended: Future | None = None
        self._cancelled = False

    @property
    def possible(self) -> bool:
        """Whether there is somebody who can be asked."""
        return bool(self._client.server_is_ready())

    def send(self) -> None:
        """Ask; what is asked for begins if it can."""
        sent = self._client.send_goal_async(self._goal, self._on_feedback, goal_uuid=self._id)
        sent.add_done_callback(self._on_answer)

    @property
    def answered(self) -> bool:
        """Whether the goal has arrived."""
        return self._ended is not None

    @property
    def done(self) -> bool:
        """Whether there is a result."""
        return self._ended is not None and self._ended.done()

    def cancel(self) -> None:
        """Have it end before its time."""
        self._cancelled = True
        if self._handle is not None:
            self._handle.cancel_goal_async()

    def close(self) -> None:
        """Let go of it, whatever becomes of it; else the node would stay announced."""
        self._client.destroy()

    def _message(self) -> Any:
        """The result of what is done, as its message."""
        assert self._ended is not None
        return self._ended.result().result

    def _on_answer(self, sent: Future) -> None:
        self._handle = sent.result()
        self._ended = self._handle.get_result_async()
        if self._cancelled:  # before it was known of
            self._handle.cancel_goal_async()

    def _on_feedback(self, message: Any) -> None:
        self.heard_at = time.monotonic()
        self._take(message.feedback)

    def _take(self, feedback: Any) -> None:
        """What is heard on the way."""
        raise NotImplementedError
