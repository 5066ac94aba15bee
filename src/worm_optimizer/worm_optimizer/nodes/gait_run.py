# SPDX-License-Identifier: Apache-2.0
"""One gait that was asked of the driver, from its goal to its result, and the heartbeat of whoever asked for it."""

from __future__ import annotations

import time
import uuid
from collections.abc import Callable
from typing import Any

from rclpy.action import ActionClient
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.task import Future
from unique_identifier_msgs.msg import UUID

from worm_msgs.action import RunGait
from worm_msgs.msg import Gait, Heartbeat
from worm_optimizer.orders import Order, RunProgress, RunResult

SILENCE_S = 3.0  # of its owner, that a run puts up with
BEAT_S = 0.25


class GaitRun:
    """Owned by whoever spins the node: no call waits.

    Args:
        node: that asks.
        heartbeat: its publisher of Heartbeat, there before the run so that it is known to the driver.
        order: what is to be run.
        wanted: whether the run is still wanted, asked for at every beat; without beats the robot comes to rest.

    Attributes:
        progress: the last word of a run that goes on, None before it.
        heard_at: when the last word came (s, monotonic).
    """

    def __init__(
        self, node: Node, heartbeat: Publisher, order: Order, wanted: Callable[[], bool]
    ) -> None:
        self.order = order
        self.progress: RunProgress | None = None
        self.heard_at = time.monotonic()
        self._node = node
        self._client = ActionClient(node, RunGait, "run_gait")
        self._heartbeat, self._wanted = heartbeat, wanted
        self._id = UUID(uuid=list(uuid.uuid4().bytes))
        self._sent: Future | None = None
        self._handle: Any = None
        self._ended: Future | None = None
        self._timer = node.create_timer(
            BEAT_S, self._beat, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )
        self._timer.cancel()
        self._cancelled = False

    @property
    def possible(self) -> bool:
        """Whether there is a driver that can be asked."""
        return bool(self._client.server_is_ready())

    def send(self) -> None:
        """Ask the driver; the run begins if it can."""
        self._sent = self._client.send_goal_async(
            _goal_of(self.order), self._on_feedback, goal_uuid=self._id
        )
        self._sent.add_done_callback(self._on_answer)
        self._timer.reset()

    @property
    def answered(self) -> bool:
        """Whether the driver has the goal."""
        return self._ended is not None

    @property
    def done(self) -> bool:
        """Whether there is a result."""
        return self._ended is not None and self._ended.done()

    def cancel(self) -> None:
        """Have the run end at its next point of rest."""
        self._cancelled = True
        if self._handle is not None:
            self._handle.cancel_goal_async()

    @property
    def result(self) -> RunResult:
        """Of a run that is done."""
        assert self._ended is not None
        return _result_of(self.order, self._ended.result().result)

    def close(self) -> None:
        """Lets go of the run, which comes to rest if it goes on; else the node would stay announced."""
        self._node.destroy_timer(self._timer)
        self._client.destroy()

    def _beat(self) -> None:
        if self._wanted():
            self._heartbeat.publish(Heartbeat(goal=self._id.uuid))

    def _on_answer(self, sent: Future) -> None:
        self._handle = sent.result()
        self._ended = self._handle.get_result_async()
        if self._cancelled:  # before the driver knew of it
            self._handle.cancel_goal_async()

    def _on_feedback(self, message: Any) -> None:
        self.heard_at = time.monotonic()
        told = message.feedback
        self.progress = RunProgress(
            told.cycle, told.elapsed, told.grooves, told.distance, told.power
        )


def _goal_of(order: Order) -> RunGait.Goal:
    gait = order.gait
    return RunGait.Goal(
        gait=Gait(
            stroke=gait.stroke,
            frequency=gait.frequency,
            direction=gait.direction,
            margin=gait.margin,
        ),
        cycles=order.cycles,
        grooves=order.grooves,
        distance=order.distance,
        heartbeat=SILENCE_S,
    )


def _result_of(order: Order, result: RunGait.Result) -> RunResult:
    names = RunResult.__dataclass_fields__.keys() - {"gait"}
    return RunResult(gait=order.gait, **{name: getattr(result, name) for name in names})
