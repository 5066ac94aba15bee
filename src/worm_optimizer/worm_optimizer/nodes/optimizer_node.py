# SPDX-License-Identifier: Apache-2.0
"""ROS node of the optimizer. It computes exact fronts on demand and answers requests for gaits from them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ParamSpec, TypeVar

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import SetParametersResult
from rclpy.action import ActionServer, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.node import Node
from rclpy.parameter import Parameter

from worm_model.errors import InputError
from worm_model.gait import FORWARD, REVERSE
from worm_model.parameters import ParameterFile, load_parameter_file
from worm_model.simulation.simulator import SimulationError
from worm_msgs.action import OptimizeGaits, ScanMargin
from worm_msgs.conditions import CONDITION_ROWS
from worm_msgs.gait import Gait, gait_of
from worm_msgs.goal_rejections import GoalRejections
from worm_msgs.node_command import declare
from worm_msgs.ros_process import ShutdownRequest, spin
from worm_msgs.srv import RequestGait
from worm_optimizer.nodes import optimizer_messages
from worm_optimizer.search import gait_request
from worm_optimizer.search.front import RobustFront, given_gait, make_front, scanned_price
from worm_optimizer.search.search_settings import (
    PARAMETER_FILE,
    SETTINGS,
    Robustness,
    Settings,
    rows,
    settings_of,
)

REJECTIONS = (InputError,)
# Largest number of stored fronts for initial lengths other than that of the parameters
MOST_RESTING = 8
_NAMES = {FORWARD: "forward", REVERSE: "reverse"}

_Arguments = ParamSpec("_Arguments")
_Result = TypeVar("_Result")


class ShutdownError(InputError):
    """A signal ended the computation."""


def _settings_of_node(node: Node) -> Settings:
    """Return the search settings from a node's parameters. Raises `InputError` if they are inconsistent."""
    return settings_of({row.parameter: node.get_parameter(row.parameter).value for row in SETTINGS})


class _RejectingServer(ActionServer):
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


class OptimizerNode(Node):
    """Server of request_gait, optimize_gaits and scan_margin, which processes one request at a time.

    The time to compute a front depends on the settings:

    - a given margin: about a second,
    - a margin scan, the parameter ``robustness`` = ``chance`` or ``any_phase``, or shaped gaits: some seconds,
    - a margin scan of shaped gaits: about a minute.

    The forward front is computed at the start, the reverse front at the first request that needs it. Fronts are stored
    until the settings, the conditions or the parameter file change; fronts for other initial lengths only the newest.

    Args:
        ended: request to end the process, which also ends a running computation.

    Raises:
        InputError, OSError: A parameter of the node is invalid.
    """

    def __init__(self, ended: ShutdownRequest) -> None:
        super().__init__("optimizer")
        self._ended = ended
        declare(self, rows)
        self._settings = _settings_of_node(self)
        file = self.get_parameter(PARAMETER_FILE).value
        self._content = load_parameter_file(file)
        self._fronts: dict[int, RobustFront] = {}
        self._resting: dict[tuple[int, float], RobustFront] = {}
        self._failures: dict[int, str] = {}
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self.create_timer(1.0, self._publish_diagnostics)
        self.add_on_set_parameters_callback(self._check_parameters)
        self.add_post_set_parameters_callback(self._apply_parameters)
        self.create_service(RequestGait, "request_gait", self._request_gait)
        self._serve(
            OptimizeGaits, "optimize_gaits", self._optimize, optimizer_messages.settings_of_goal
        )
        self._serve(ScanMargin, "scan_margin", self._scan, optimizer_messages.scan_of_goal)
        self._first = self.create_timer(1e-3, self._prepare)

    # --- the fronts --------------------------------------------------------------------------------

    def _computed(
        self,
        compute: Callable[_Arguments, _Result],
        *arguments: _Arguments.args,
        **keywords: _Arguments.kwargs,
    ) -> _Result:
        """Return the result of a long computation. Raises `ShutdownError` if a signal requests the end of the node."""
        try:
            with self._ended.interrupting():
                return compute(*arguments, **keywords)
        except KeyboardInterrupt:
            raise ShutdownError("the optimizer is ending") from None

    def _prepare(self) -> None:
        """Compute the forward front in advance."""
        self._first.cancel()
        try:
            self._front(FORWARD)
        except ShutdownError:
            return
        except (InputError, SimulationError) as error:
            self.get_logger().error(f"the forward front cannot be computed: {error}")

    def _front(self, direction: int) -> RobustFront:
        """Return the front of a direction, and compute it if it is not stored.

        Raises `InputError` or `SimulationError` if it cannot be computed.
        """
        if direction not in self._fronts:
            self._failures.pop(direction, None)
            try:
                self._store(self._computed(make_front, self._content, self._settings, direction))
            except (InputError, SimulationError) as error:
                self._failures[direction] = str(error)
                raise
        return self._fronts[direction]

    def _store(self, front: RobustFront) -> None:
        """Store a front, from which later requests of its direction are answered."""
        self._fronts[front.direction] = front
        self.get_logger().info(
            f"optimizer ready, {_NAMES[front.direction]}: front of {len(front.gaits)} gaits, "
            f"{front.described}"
        )
        if warning := front.warning(front.three.values()):
            self.get_logger().warning(warning)

    def _forget(self) -> None:
        self._fronts, self._resting, self._failures = {}, {}, {}

    def _check_parameters(self, parameters: Sequence[Parameter]) -> SetParametersResult:
        changes = {parameter.name: parameter.value for parameter in parameters}
        try:
            self._under(changes)
            if PARAMETER_FILE in changes:
                load_parameter_file(changes[PARAMETER_FILE])
        except InputError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _apply_parameters(self, parameters: Sequence[Parameter]) -> None:
        changes = {parameter.name: parameter.value for parameter in parameters}
        settings = self._under(changes)
        if PARAMETER_FILE in changes:
            self._content = load_parameter_file(changes[PARAMETER_FILE])
        elif settings.conditions == self._settings.conditions:
            return
        self._settings = settings
        self._forget()
        self._first.reset()

    def _under(self, changes: Mapping[str, Any]) -> Settings:
        """Return the settings with changed conditions.

        ``changes`` contains new values of node parameters by name, of which only the conditions are used. Raises
        `ConditionsError` if they are inadmissible.
        """
        conditions = {name: value for name, value in changes.items() if name in CONDITION_ROWS}
        changed = dataclasses.replace(self._settings.conditions, **conditions)
        return dataclasses.replace(self._settings, conditions=changed)

    # --- requests ----------------------------------------------------------------------------------

    def _request_gait(
        self, request: RequestGait.Request, response: RequestGait.Response
    ) -> RequestGait.Response:
        try:
            content = gait_request.resting_content(self._content, request.initial_length)
            if request.objective == RequestGait.Request.GIVEN:
                answer = self._prediction(gait_of(request.gait), content)
            else:
                wanted = gait_request.request_of(request.objective, request.speed, request.power)
                direction = gait_request.checked_direction(request.direction)
                answer = self._answer(wanted, direction, content)
        except (InputError, SimulationError) as error:
            answer = gait_request.GaitAnswer(gait_request.RequestStatus.INVALID, str(error))
        return optimizer_messages.fill_response(response, answer)

    def _prediction(self, gait: Gait, content: ParameterFile) -> gait_request.GaitAnswer:
        """Return the prediction of a given gait. Raises the errors of `given_gait`."""
        prediction, warning = self._computed(given_gait, gait, content, self._settings)
        return gait_request.GaitAnswer(gait_request.RequestStatus.DONE, warning, prediction)

    def _answer(
        self, wanted: gait_request.GaitRequest, direction: int, content: ParameterFile
    ) -> gait_request.GaitAnswer:
        try:
            front = self._front(direction)
            if content is not self._content:
                front = self._resting_front(front, content)
            answer = gait_request.select(front, wanted)
        except (InputError, SimulationError) as error:
            return gait_request.GaitAnswer(
                gait_request.RequestStatus.NO_FRONT, f"there is no front: {error}"
            )
        if answer.status is not gait_request.RequestStatus.DONE:
            return answer
        assert answer.prediction is not None
        warning = front.warning([answer.prediction])
        message = optimizer_messages.with_warning(front.described, warning)
        return dataclasses.replace(answer, message=message)

    def _resting_front(self, front: RobustFront, content: ParameterFile) -> RobustFront:
        """Return the front for the initial length in ``content``.

        With the criterion `Robustness.MARGIN`, it has the margin of ``front``, and its reason states this. Any other
        criterion is evaluated again for the new initial length.
        """
        key = front.direction, round(content.parameters.initial_length / gait_request.SAME_LENGTH)
        if key not in self._resting:
            settings = front.settings.with_margin(front.margin)
            if len(self._resting) >= MOST_RESTING:
                self._resting.pop(next(iter(self._resting)))
            resting = self._computed(make_front, content, settings, front.direction)
            if settings.robustness is Robustness.MARGIN:
                phase = 1e3 * front.three["cruise"].groove_phase
                reason = f"as at groove phase {phase:.1f} mm: {front.reason}"
                resting = dataclasses.replace(resting, reason=reason)
            self._resting[key] = resting
        return self._resting[key]

    # --- actions --------------------------------------------------------------------------------

    def _serve(
        self,
        kind: Any,
        name: str,
        execute: Callable[[ServerGoalHandle], Any],
        settings_of: Callable[[Settings, Any], object],
    ) -> None:
        """Serve an action that rejects goals with invalid settings or an invalid direction."""

        def why_not(goal: Any) -> str:
            try:
                settings_of(self._settings, goal)
                gait_request.checked_direction(goal.direction)
            except InputError as error:
                return str(error)
            return ""

        _RejectingServer(self, kind, name, execute, why_not)

    def _optimize(self, goal: ServerGoalHandle) -> OptimizeGaits.Result:
        """Compute a front with the settings of a goal.

        If this succeeds, the settings apply to all later requests in both directions.
        """
        try:
            settings = optimizer_messages.settings_of_goal(self._settings, goal.request)
            direction = gait_request.checked_direction(goal.request.direction)
            front = self._computed(make_front, self._content, settings, direction)
        except (InputError, SimulationError) as error:
            goal.abort()
            return OptimizeGaits.Result(message=str(error))
        self._settings = settings
        self._forget()
        self._store(front)
        goal.succeed()
        return optimizer_messages.optimize_result(front)

    def _scan(self, goal: ServerGoalHandle) -> ScanMargin.Result:
        try:
            settings = optimizer_messages.scan_of_goal(self._settings, goal.request)
            direction = gait_request.checked_direction(goal.request.direction)
            price = self._computed(scanned_price, self._content, settings, direction)
        except (InputError, SimulationError) as error:
            goal.abort()
            return ScanMargin.Result(message=str(error))
        goal.succeed()
        return optimizer_messages.scan_result(price)

    # --- the node's health -----------------------------------------------------------------------

    def _publish_diagnostics(self) -> None:
        array = DiagnosticArray()
        array.header.stamp = self.get_clock().now().to_msg()
        array.status = [self._status_of(direction) for direction in (FORWARD, REVERSE)]
        self._diagnostics.publish(array)

    def _status_of(self, direction: int) -> DiagnosticStatus:
        robot = self.get_namespace().strip("/")
        name = f"{robot}/optimizer: {_NAMES[direction]} front".lstrip("/")
        status = DiagnosticStatus(name=name, hardware_id=robot)
        front = self._fronts.get(direction)
        if direction in self._failures:
            status.level = DiagnosticStatus.ERROR
            status.message = f"there is no front: {self._failures[direction]}"
        elif front is None:
            status.level = DiagnosticStatus.OK
            status.message = "not computed before the first request"
        else:
            status.level = DiagnosticStatus.OK
            status.message = f"{len(front.gaits)} gaits"
            status.values = [KeyValue(key="margin_m", value=f"{front.margin:.6f}")]
        return status


def run(ended: ShutdownRequest) -> None:
    """Run the node until SIGINT, SIGTERM or SIGHUP."""
    node = OptimizerNode(ended)
    try:
        spin(node, ended)
    finally:
        node.destroy_node()
