# SPDX-License-Identifier: Apache-2.0
"""An action server that answers every goal of a flood, and that a stop can empty."""

from collections.abc import Awaitable, Callable
from typing import Any

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile

from worm_driver.errors import DriverError, LimitError

#: goals that may wait to be begun; those beyond are rejected at once
QUEUE = 4
#: no request is dropped by the middleware, however many wait
_EVERY_REQUEST = QoSProfile(history=HistoryPolicy.KEEP_ALL)
#: s, for which the result of a goal is stored: a client requests it as soon as its goal is accepted
_RESULT_STORED = 60


class GoalServer(ActionServer):
    """Serves an action in the node's executor, all requests that wait in one go.

    A goal is accepted once it has begun, and rejected otherwise.

    Args:
        node: which serves the action.
        action: its type.
        name: of the action.
        begin: called with the id of a goal, its request and the number of stops before it was received; raises
            DriverError to reject it.
        rejected: called in any thread with the id of a goal and why it is rejected.
        execute, cancel: as in rclpy.

    Attributes:
        stops: how often `stop` was called.
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
        # of the goal that is being answered: its id, its place in the queue, the stops before it was received
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
        """Reject every goal that was received and has not begun. In any thread."""
        with self._lock:
            self.stops += 1
            waiting = self._accept_goals()
        for header, request in waiting:
            response = self._action_type.Impl.SendGoalService.Response()
            self._handle.send_goal_response(header, response)
            self._rejected(
                bytes(request.goal_id.uuid), "a stop came after this goal: send it again"
            )

    def take_data(self) -> dict[str, Any]:
        """Take all goals that wait, in place of the first one (see rclpy)."""
        are_there: bool = self._is_goal_request_ready
        self._is_goal_request_ready = False
        data: dict[str, Any] = super().take_data()
        with self._lock:
            data["goals"] = self._accept_goals() if are_there else []
            data["stops"] = self.stops
        return data

    async def execute(self, taken_data: dict[str, Any]) -> None:
        """Answer the requests (see rclpy)."""
        self._stops_before = taken_data.pop("stops")
        for self._place, goal in enumerate(taken_data.pop("goals")):
            self._goal_id = bytes(goal[1].goal_id.uuid)
            await self._execute_goal_request(goal)
        await super().execute(taken_data)

    def _accept_goals(self) -> list[tuple[Any, Any]]:
        """The goal requests that wait; the lock is held."""
        kind, goals = self._action_type.Impl.SendGoalService.Request, []
        while all(taken := self._handle.take_goal_request(kind)):
            goals.append(taken)
        return goals

    def _on_goal(self, request: Any) -> GoalResponse:
        try:
            if self._place >= QUEUE:
                raise LimitError(f"{QUEUE} goals wait to be begun already")
            self._begin(self._goal_id, request, self._stops_before)
        except DriverError as error:
            self._rejected(self._goal_id, str(error))
            return GoalResponse.REJECT
        return GoalResponse.ACCEPT
