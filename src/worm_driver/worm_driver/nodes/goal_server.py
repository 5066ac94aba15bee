# SPDX-License-Identifier: Apache-2.0
"""Action server whose waiting goals a stop rejects. It answers every goal of a burst."""

from collections.abc import Awaitable, Callable
from typing import Any

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile

from worm_driver.driver_errors import DriverError

#: The middleware drops no request, however many wait.
_EVERY_REQUEST = QoSProfile(history=HistoryPolicy.KEEP_ALL)
#: s, time for which the result of a goal is stored. It is short, because a client requests the result as soon as its
#: goal is accepted.
_RESULT_STORED = 60


class GoalServer(ActionServer):
    """Action server in the node's executor.

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
        # Id of the present goal, and the number of stops before it was taken from the middleware.
        self._goal_id, self._stops_before = b"", 0
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
        kind, waiting = self._action_type.Impl.SendGoalService, []
        with self._lock:
            self.stops += 1
            while all(taken := self._handle.take_goal_request(kind.Request)):
                waiting.append(taken)
        for header, request in waiting:
            self._handle.send_goal_response(header, kind.Response())
            self._rejected(
                bytes(request.goal_id.uuid), "a stop followed this goal: send the goal again"
            )

    def take_data(self) -> dict[str, Any]:
        """Take requests from the middleware (see rclpy), with the number of stops before."""
        stops = self.stops
        return {"stops": stops, **super().take_data()}

    async def execute(self, taken_data: dict[str, Any]) -> None:
        """Answer the requests (see rclpy)."""
        self._stops_before = taken_data.pop("stops")
        if "goal" in taken_data:
            self._goal_id = bytes(taken_data["goal"][1].goal_id.uuid)
        await super().execute(taken_data)

    def _on_goal(self, request: Any) -> GoalResponse:
        try:
            self._begin(self._goal_id, request, self._stops_before)
        except DriverError as error:
            self._rejected(self._goal_id, str(error))
            return GoalResponse.REJECT
        return GoalResponse.ACCEPT
