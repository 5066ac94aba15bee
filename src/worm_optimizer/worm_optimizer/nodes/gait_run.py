# SPDX-License-Identifier: Apache-2.0
"""One gait that was asked of the driver, from its goal to its result, and the heartbeat of whoever asked for it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.publisher import Publisher

from worm_msgs.action import RunGait
from worm_msgs.msg import Gait, Heartbeat
from worm_optimizer.nodes.action_goal import ActionGoal
from worm_optimizer.nodes.optimizer_messages import value_of
from worm_optimizer.orders import Order, RunProgress, RunResult

SILENCE_S = 3.0  # of its owner, that a run puts up with
BEAT_S = 0.25


class GaitRun(ActionGoal):
    """A goal of run_gait that is heard of; cancelled, it ends at its next point of rest.

    Args:
        node: that asks.
        heartbeat: its publisher of Heartbeat, there before the run so that it is known to the driver.
        order: what is to be run.
        wanted: whether the run is still wanted, asked for at every beat; without beats the robot comes to rest.

    Attributes:
        progress: the last word of a run that goes on, None before it.
    """

    def __init__(
        self, node: Node, heartbeat: Publisher, order: Order, wanted: Callable[[], bool]
    ) -> None:
        super().__init__(node, RunGait, "run_gait", _goal_of(order))
        self.order = order
        self.progress: RunProgress | None = None
        self._heartbeat, self._wanted = heartbeat, wanted
        self._timer = node.create_timer(
            BEAT_S, self._beat, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )
        self._timer.cancel()

    def send(self) -> None:
        """Ask the driver; the run begins if it can."""
        super().send()
        self._timer.reset()

    @property
    def result(self) -> RunResult:
        """Of a run that is done."""
        return value_of(RunResult, self._message(), gait=self.order.gait)

    def close(self) -> None:
        """Lets go of the run, which comes to rest if it goes on."""
        self._node.destroy_timer(self._timer)
        super().close()

    def _beat(self) -> None:
        if self._wanted():
            self._heartbeat.publish(Heartbeat(goal=self._id.uuid))

    def _take(self, feedback: Any) -> None:
        self.progress = value_of(RunProgress, feedback)


def _goal_of(order: Order) -> RunGait.Goal:
    return RunGait.Goal(
        gait=Gait(**asdict(order.gait)),
        cycles=order.cycles,
        grooves=order.grooves,
        distance=order.distance,
        heartbeat=SILENCE_S,
    )
