# SPDX-License-Identifier: Apache-2.0
"""Client of one run_gait goal, from the request to its result, including the client's heartbeat."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.publisher import Publisher

from worm_msgs.action import RunGait
from worm_msgs.msg import Gait, Heartbeat
from worm_optimizer.nodes.action_goal import ActionGoal
from worm_optimizer.nodes.message_fields import value_of
from worm_optimizer.robot_commands import GaitCommand, RunProgress, RunResult

SILENCE_S = 3.0  # heartbeat timeout of a run, s
BEAT_S = 0.25  # heartbeat period, s


class GaitRun(ActionGoal):
    """Goal of run_gait with heartbeats. A cancelled run ends at its next point of rest.

    Args:
        node: the client's node.
        heartbeat: publisher of Heartbeat. It must exist before the run, so that the driver has discovered it.
        command: the gait, and the condition at which its run ends.
        wanted: called before each heartbeat. If it returns False, no heartbeat is sent. After `SILENCE_S` without
            heartbeats, the robot comes to rest.

    Attributes:
        command: the gait, and the condition at which its run ends.
        progress: latest feedback of the run; None before the first feedback.
    """

    def __init__(
        self, node: Node, heartbeat: Publisher, command: GaitCommand, wanted: Callable[[], bool]
    ) -> None:
        super().__init__(node, RunGait, "run_gait", _goal_of(command))
        self.command = command
        self.progress: RunProgress | None = None
        self._heartbeat, self._wanted = heartbeat, wanted
        self._timer = node.create_timer(
            BEAT_S, self._beat, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )
        self._timer.cancel()

    def send(self) -> None:
        """Send the goal to the driver and start the heartbeats."""
        super().send()
        self._timer.reset()

    @property
    def result(self) -> RunResult:
        """Result of the run, available when `done` is True. After a rejection, its numbers are NaN."""
        if self.rejected:
            return value_of(RunResult, _no_result(self.rejection), gait=self.command.gait)
        return value_of(RunResult, self._message(), gait=self.command.gait)

    def close(self) -> None:
        """Stop the heartbeats and free the client. A run that has not ended comes to rest after `SILENCE_S`."""
        self._node.destroy_timer(self._timer)
        super().close()

    def _beat(self) -> None:
        if self._wanted():
            self._heartbeat.publish(Heartbeat(goal=self._id.uuid))

    def _take(self, feedback: Any) -> None:
        self.progress = value_of(RunProgress, feedback)


def _no_result(message: str) -> RunGait.Result:
    names = ("grooves", "distance", "speed", "power", "cost_of_transport", "idle_power")
    return RunGait.Result(message=message, **dict.fromkeys(names, math.nan))


def _goal_of(command: GaitCommand) -> RunGait.Goal:
    return RunGait.Goal(
        gait=Gait(**asdict(command.gait)),
        cycles=command.cycles,
        grooves=command.grooves,
        distance=command.distance,
        heartbeat=SILENCE_S,
    )
