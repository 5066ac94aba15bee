# SPDX-License-Identifier: Apache-2.0
"""Client of one run_gait goal, from the request to its result, including the client's heartbeat."""

from __future__ import annotations

import math
import time
import uuid
from collections.abc import Callable
from dataclasses import asdict
from typing import Any

from rclpy.action import ActionClient
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.task import Future
from unique_identifier_msgs.msg import UUID

from worm_msgs.action import RunGait
from worm_msgs.goal_rejections import REJECTIONS_QOS, rejections_topic
from worm_msgs.msg import Gait, GoalRejection, Heartbeat
from worm_optimizer.nodes.robot_telemetry import value_of
from worm_optimizer.robot_commands import GaitCommand, RunProgress, RunResult

ACTION = "run_gait"
SILENCE_S = 3.0  # heartbeat timeout of a run, s
BEAT_S = 0.25  # heartbeat period, s
REASON_S = 2.0  # longest time from a rejection to the message with its reason, s


class GaitRun:
    """Goal of run_gait with heartbeats. A cancelled run ends at its next point of rest.

    Only the thread that spins the node may use it. No call blocks.

    Args:
        node: the client's node.
        heartbeat: publisher of Heartbeat. It must exist before the run, so that the driver has discovered it.
        command: the gait, and the condition at which its run ends.
        wanted: called before each heartbeat. If it returns False, no heartbeat is sent. After `SILENCE_S` without
            heartbeats, the robot comes to rest.

    Attributes:
        command: the gait, and the condition at which its run ends.
        progress: latest feedback of the run; None before the first feedback.
        rejected: True if the driver rejected the goal.
        received_at: time of the latest feedback, s (monotonic clock); before the first feedback, time at
            which this object was created.
    """

    def __init__(
        self, node: Node, heartbeat: Publisher, command: GaitCommand, wanted: Callable[[], bool]
    ) -> None:
        self.command = command
        self.progress: RunProgress | None = None
        self.rejected = False
        self.received_at = time.monotonic()
        self._node, self._heartbeat, self._wanted = node, heartbeat, wanted
        self._client = ActionClient(node, RunGait, ACTION)
        self._id = UUID(uuid=list(uuid.uuid4().bytes))
        self._handle: Any = None
        self._ended: Future | None = None
        self._cancelled = False
        self._reason, self._rejected_at = "", math.inf
        self._rejections = node.create_subscription(
            GoalRejection, rejections_topic(ACTION), self._on_rejection, REJECTIONS_QOS
        )
        self._timer = node.create_timer(
            BEAT_S, self._beat, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )
        self._timer.cancel()

    @property
    def possible(self) -> bool:
        """True if the action has a server."""
        return bool(self._client.server_is_ready())

    def send(self) -> None:
        """Send the goal to the driver and start the heartbeats."""
        ends = {name: getattr(self.command, name) for name in ("cycles", "grooves", "distance")}
        gait = Gait(**asdict(self.command.gait))
        goal = RunGait.Goal(gait=gait, heartbeat=SILENCE_S, **ends)
        sent = self._client.send_goal_async(goal, self._on_feedback, goal_uuid=self._id)
        sent.add_done_callback(self._on_answer)
        self._timer.reset()

    @property
    def answered(self) -> bool:
        """True if the goal was accepted or rejected."""
        return self.rejected or self._ended is not None

    @property
    def done(self) -> bool:
        """True when the result or the reason of a rejection has arrived, or `REASON_S` after a rejection."""
        if self.rejected:
            return bool(self._reason) or time.monotonic() > self._rejected_at + REASON_S
        return self._ended is not None and self._ended.done()

    @property
    def result(self) -> RunResult:
        """Result of the run, available when `done` is True. After a rejection, it has no measurements."""
        if self.rejected:
            reason = self._reason or "see the log of the driver for the reason"
            return RunResult(self.command.gait, False, f"rejected: {reason}")
        assert self._ended is not None
        return value_of(RunResult, self._ended.result().result, gait=self.command.gait)

    def cancel(self) -> None:
        """Cancel the goal. A goal that is not accepted yet is cancelled as soon as the driver accepts it."""
        self._cancelled = True
        if self._handle is not None:
            self._handle.cancel_goal_async()

    def close(self) -> None:
        """Stop the heartbeats and free the client. A run that has not ended comes to rest after `SILENCE_S`."""
        self._node.destroy_timer(self._timer)
        self._node.destroy_subscription(self._rejections)
        self._client.destroy()

    def _beat(self) -> None:
        if self._wanted():
            self._heartbeat.publish(Heartbeat(goal=self._id.uuid))

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
            self._reason = message.reason

    def _on_feedback(self, message: Any) -> None:
        self.received_at = time.monotonic()
        self.progress = value_of(RunProgress, message.feedback)
