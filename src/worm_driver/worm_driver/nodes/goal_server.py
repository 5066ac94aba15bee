# SPDX-License-Identifier: Apache-2.0
"""Action server that answers every goal of a burst. A stop rejects all waiting goals."""

from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import Any

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile

from worm_driver.driver_errors import DriverError, RejectedError

#: largest number of goals that are handled of those that arrive at once; the others are rejected
QUEUE = 4
#: The middleware drops no request, however many wait.
_EVERY_REQUEST = QoSProfile(history=HistoryPolicy.KEEP_ALL)
#: s, time for which the result of a goal is stored. It is short, because a client requests the result as soon as its
#: goal is accepted.
_RESULT_STORED = 60


class GoalServer(ActionServer):
    """Action server in the node's executor that handles all waiting goals at once.

    ``begin`` is called before a goal is answered. The goal is accepted if ``begin`` returns, and rejected if it raises
    DriverError. ``execute`` runs after the acceptance.

    Args:
        node: node of the action.
        action: type of the action.
        name: name of the action.
        begin: called with the id of a goal, its request and the number of stops before the goal arrived. Raises
            DriverError to reject the goal.
        rejected: called in any thread with the id of a goal and the reason for its rejection.
        execute, cancel: as in rclpy.

    Attributes:
        stops: number of calls of `stop`.
    """

    def __init__(
        self,
        node: Node,
        action: type,
        name: str,
        begin: Callable[[bytes, Any, int], None],
        rejected: Callable[[bytes, str], None],
        execute: Callable[[ServerGoalHandle], Awaitable[Any]],
        cancel: Callable[[ServerGoalHandle], CancelResponse],
    ):
        self.stops = 0
        self._begin, self._rejected = begin, rejected
        # Id of the present goal, its place in the queue, and the number of stops before it arrived.
        self._goal_id, self._place, self._stops_before = b"", 0, 0
        self._is_goal_request_ready = False
        super().__init__(
            node,
            action,
            name,
            execute,
            goal_callback=self._on_goal,
            cancel_callback=cancel,
            goal_service_qos_profile=_EVERY_REQUEST,
            result_service_qos_profile=_EVERY_REQUEST,
            cancel_service_qos_profile=_EVERY_REQUEST,
            result_timeout=_RESULT_STORED,
        )

    def stop(self) -> None:
        """Reject every goal that waits in the middleware, and count the stop. Safe in any thread.

        ``begin`` must reject the goals that were taken before: their number of stops is smaller than `stops`.
        """
        with self._lock:
            self.stops += 1
            waiting = self._take_goals()
        for header, request in waiting:
            response = self._action_type.Impl.SendGoalService.Response()
            with suppress(rclpy_implementation.RCLError):  # The client may have gone away.
                self._handle.send_goal_response(header, response)
            self._rejected(
                bytes(request.goal_id.uuid), "a stop followed this goal: send the goal again"
            )

    def take_data(self) -> dict[str, Any]:
        """Return all waiting goals instead of the first one (see rclpy)."""
        are_ready: bool = self._is_goal_request_ready
        self._is_goal_request_ready = False
        data: dict[str, Any] = super().take_data()
        with self._lock:
            data["goals"] = self._take_goals() if are_ready else []
            data["stops"] = self.stops
        return data

    async def execute(self, taken_data: dict[str, Any]) -> None:
        """Answer the requests (see rclpy)."""
        self._stops_before = taken_data.pop("stops")
        for self._place, goal in enumerate(taken_data.pop("goals")):
            self._goal_id = bytes(goal[1].goal_id.uuid)
            await self._execute_goal_request(goal)
        await super().execute(taken_data)

    def _take_goals(self) -> list[tuple[Any, Any]]:
        """Take all waiting goal requests from the middleware and return them, unanswered. The caller holds the lock."""
        kind, goals = self._action_type.Impl.SendGoalService.Request, []
        while all(taken := self._handle.take_goal_request(kind)):
            goals.append(taken)
        return goals

    def _on_goal(self, request: Any) -> GoalResponse:
        try:
            if self._place >= QUEUE:
                raise RejectedError(f"more than {QUEUE} goals arrived at once: send this one later")
            self._begin(self._goal_id, request, self._stops_before)
        except DriverError as error:
            self._rejected(self._goal_id, str(error))
            return GoalResponse.REJECT
        return GoalResponse.ACCEPT
