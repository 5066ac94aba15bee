# SPDX-License-Identifier: Apache-2.0
"""ROS node of the optimizer. It computes exact fronts on demand and answers requests for gaits from them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

from rcl_interfaces.msg import SetParametersResult
from rclpy.action import ActionServer
from rclpy.action.server import ServerGoalHandle
from rclpy.node import Node
from rclpy.parameter import Parameter

from worm_model.errors import InputError
from worm_model.gait import FORWARD, REVERSE
from worm_model.parameters import ParameterFile, load_parameter_file
from worm_model.simulation.simulator import SimulationError
from worm_msgs.action import OptimizeGaits, ScanMargin
from worm_msgs.conditions import CONDITION_ROWS
from worm_msgs.gait import gait_of
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

_Result = TypeVar("_Result")


class ShutdownError(InputError):
    """A signal ended the computation."""


def _settings_of_node(node: Node) -> Settings:
    """Return the search settings from a node's parameters. Raises `InputError` if they are inconsistent."""
    return settings_of({row.name: node.get_parameter(row.name).value for row in SETTINGS})


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
        self.add_on_set_parameters_callback(self._check_parameters)
        self.add_post_set_parameters_callback(self._apply_parameters)
        self.create_service(RequestGait, "request_gait", self._request_gait)
        self._serve(OptimizeGaits, "optimize_gaits", self._optimize)
        self._serve(ScanMargin, "scan_margin", self._scan)
        self._first = self.create_timer(1e-3, self._prepare)

    # --- the fronts --------------------------------------------------------------------------------

    def _computed(self, compute: Callable[..., _Result], *arguments: Any) -> _Result:
        """Return the result of a long computation. Raises `ShutdownError` if a signal requests the end of the node."""
        try:
            with self._ended.interrupting():
                return compute(*arguments)
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
            self._store(self._computed(make_front, self._content, self._settings, direction))
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
        self._fronts, self._resting = {}, {}

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
                gait = gait_of(request.gait)
                prediction, warning = self._computed(given_gait, gait, content, self._settings)
                done = gait_request.RequestStatus.DONE
                answer = gait_request.GaitAnswer(done, warning, prediction)
            else:
                wanted = gait_request.request_of(request.objective, request.speed, request.power)
                direction = gait_request.checked_direction(request.direction)
                answer = self._answer(wanted, direction, content)
        except (InputError, SimulationError) as error:
            answer = gait_request.GaitAnswer(gait_request.RequestStatus.INVALID, str(error))
        return optimizer_messages.fill_response(response, answer)

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

    def _serve(self, kind: Any, name: str, answer: Callable[[Any], Any]) -> None:
        """Serve an action. A goal whose answer cannot be computed is aborted, and its result contains the reason."""

        def execute(goal: ServerGoalHandle) -> Any:
            try:
                result = answer(goal.request)
            except (InputError, SimulationError) as error:
                goal.abort()
                return kind.Result(message=str(error))
            goal.succeed()
            return result

        ActionServer(self, kind, name, execute)

    def _optimize(self, goal: OptimizeGaits.Goal) -> OptimizeGaits.Result:
        """Compute a front with the settings of a goal, which apply to all later requests in both directions."""
        settings = optimizer_messages.settings_of_goal(self._settings, goal)
        direction = gait_request.checked_direction(goal.direction)
        front = self._computed(make_front, self._content, settings, direction)
        self._settings = settings
        self._forget()
        self._store(front)
        return optimizer_messages.optimize_result(front)

    def _scan(self, goal: ScanMargin.Goal) -> ScanMargin.Result:
        settings = optimizer_messages.scan_of_goal(self._settings, goal)
        direction = gait_request.checked_direction(goal.direction)
        price = self._computed(scanned_price, self._content, settings, direction)
        return optimizer_messages.scan_result(price)


def run(ended: ShutdownRequest) -> None:
    """Run the node until SIGINT, SIGTERM or SIGHUP."""
    node = OptimizerNode(ended)
    try:
        spin(node, ended)
    finally:
        node.destroy_node()
