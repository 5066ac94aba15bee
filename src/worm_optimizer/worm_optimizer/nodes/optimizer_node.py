# SPDX-License-Identifier: Apache-2.0
"""The optimizer as a ROS node: answers requests from the current fronts, computes new ones on request."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rcl_interfaces.msg import SetParametersResult
from rclpy.action import ActionServer, CancelResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.task import Future

from worm_model.gait import FORWARD, REVERSE
from worm_model.parameters import ParameterError, ParameterFile, load_parameter_file
from worm_msgs.action import OptimizeGaits, ScanMargin
from worm_msgs.node_command import declare, run_node
from worm_msgs.ros_process import Ending, spin
from worm_msgs.srv import RequestGait
from worm_optimizer.nodes import optimizer_messages, optimizer_parameters
from worm_optimizer.search.cache import Cache
from worm_optimizer.search.front import (
    Progress,
    RobustFront,
    both_ways,
    is_symmetric,
    load_current,
    store_current,
)
from worm_optimizer.search.gait_request import (
    GaitAnswer,
    GaitRequest,
    RequestStatus,
    answer,
    request_of,
)
from worm_optimizer.search.optimizer_errors import OptimizerError
from worm_optimizer.search.price_of_robustness import PriceOfRobustness
from worm_optimizer.search.resting_phase import SAME_LENGTH, resting_answer
from worm_optimizer.search.search_settings import Robustness, Settings
from worm_optimizer.search.worker import FrontJob, Job, Outcome, ScanJob, Ticket, WorkQueue

_POLL_PERIOD = 0.02  # s, how late feedback may be; a request waits for no poll
_NAMES = {FORWARD: "forward", REVERSE: "reverse"}


def _computing(fraction: float, doing: str) -> GaitAnswer:
    message = (
        f"the front is being computed, {100.0 * fraction:.0f} % done ({doing}): ask again soon"
    )
    return GaitAnswer(RequestStatus.COMPUTING, message)


def _front_jobs(scheduler: str) -> Callable[[ParameterFile, Settings, int, Cache], FrontJob]:
    """What makes jobs of fronts: of this computer or, for what takes long, of a cluster. Raises `OptimizerError`."""
    if not scheduler:
        return FrontJob
    try:
        from worm_optimizer.study.cluster_front import ClusterFrontJob
    except ModuleNotFoundError as error:  # the optional set, which a robot goes without
        raise OptimizerError(
            f"scheduler: {error.name} is not installed: "
            "pip install -r requirements-study.txt -c constraints.txt, or leave the scheduler out"
        ) from None

    def job(content: ParameterFile, settings: Settings, direction: int, cache: Cache) -> FrontJob:
        long = settings.robustness is not Robustness.MARGIN
        own = content, settings, direction, cache
        return ClusterFrontJob(*own, scheduler) if long else FrontJob(*own)

    return job


class OptimizerNode(Node):
    """Answers request_gait, optimize_gaits and scan_margin; the work is a worker process's.

    Raises `ParameterError`, `OptimizerError` or OSError on parameters that cannot work.
    """

    def __init__(self) -> None:
        super().__init__("optimizer")
        declare(self, optimizer_parameters.rows)
        self._settings = optimizer_parameters.node_settings(self)
        self._cache = Cache.at(optimizer_parameters.cache_directory(self))
        self._front_job = _front_jobs(self.get_parameter(optimizer_parameters.SCHEDULER).value)
        self._queue = WorkQueue()
        self._preparing: list[Ticket] = []
        self._goals: dict[bytes, Ticket] = {}
        self._poll_timer = self.create_timer(_POLL_PERIOD, self._poll)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self.create_timer(1.0, self._publish_diagnostics)
        self._prepare(
            load_parameter_file(self.get_parameter(optimizer_parameters.PARAMETER_FILE).value)
        )
        self.add_on_set_parameters_callback(self._check_parameters)
        self.add_post_set_parameters_callback(self._take_parameters)
        self.create_service(RequestGait, "request_gait", self._request_gait)
        cancel = self._cancel
        ActionServer(self, OptimizeGaits, "optimize_gaits", self._optimize, cancel_callback=cancel)
        ActionServer(self, ScanMargin, "scan_margin", self._scan, cancel_callback=cancel)

    def close(self) -> None:
        """Ends the worker process."""
        self._queue.close()

    # --- the fronts of this parameter file -----------------------------------------------------

    def _prepare(self, content: ParameterFile) -> None:
        """Loads the fronts of a parameter file, or has them computed."""
        for ticket in self._preparing:
            self._queue.cancel(ticket)
        self._content = content
        self._preparing = []
        self._fronts: dict[int, RobustFront] = {}
        self._absences = dict.fromkeys(_NAMES, _computing(0.0, "starting"))
        self._load_fronts()
        missing = set(_NAMES) - set(self._fronts)
        if missing:
            self.get_logger().info(
                "computing a front for these parameters, which takes about a minute; it is kept for the next start"
            )
        if is_symmetric(content.parameters):
            missing &= {FORWARD}  # the reverse front comes with it
        for direction in sorted(missing, reverse=True):
            job = self._front_job(content, self._settings, direction, self._cache)
            progressed = partial(self._note_progress, direction)
            ticket = Ticket(job, progressed, partial(self._note_end, direction))
            self._preparing.append(ticket)
            self._submit(ticket)

    def _load_fronts(self) -> None:
        for direction in set(_NAMES) - set(self._fronts):
            front = load_current(self._content, self._settings, direction, self._cache)
            if front is not None:
                self._take_front(front)

    def _note_progress(self, direction: int, progress: Progress) -> None:
        self._note_absence(direction, _computing(progress.fraction, progress.doing))

    def _note_end(self, direction: int, outcome: Outcome) -> None:
        if isinstance(outcome.result, RobustFront):
            for front in both_ways(outcome.result, self._content.parameters):
                self._take_front(front)
        if outcome.failure:
            message = f"there is no front: {outcome.failure}"
            self._note_absence(direction, GaitAnswer(RequestStatus.NO_FRONT, message))
            self.get_logger().error(f"{_NAMES[direction]}: {message}")

    def _note_absence(self, direction: int, absence: GaitAnswer) -> None:
        symmetric = is_symmetric(self._content.parameters)
        self._absences |= dict.fromkeys(_NAMES if symmetric else [direction], absence)

    def _take_front(self, front: RobustFront) -> None:
        """Answers requests from a front from now on."""
        self._fronts[front.direction] = front
        self.get_logger().info(
            f"optimizer ready, {_NAMES[front.direction]}: front of margin "
            f"{1e3 * front.margin:.1f} mm, {len(front.predictions)} gaits ({front.reason}), hypervolume "
            f"{100.0 * front.hypervolume_share:.2f} % of the true front's, source {front.source}"
        )

    def _check_parameters(self, parameters: Sequence[Parameter]) -> SetParametersResult:
        for parameter in parameters:
            if parameter.name == optimizer_parameters.PARAMETER_FILE:
                try:
                    load_parameter_file(parameter.value)
                except ParameterError as error:
                    return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _take_parameters(self, parameters: Sequence[Parameter]) -> None:
        for parameter in parameters:
            if parameter.name == optimizer_parameters.PARAMETER_FILE:
                self._prepare(load_parameter_file(parameter.value))

    # --- requests ----------------------------------------------------------------------------------

    def _request_gait(
        self, request: RequestGait.Request, response: RequestGait.Response
    ) -> RequestGait.Response:
        try:
            asked = request_of(request.objective, request.speed, request.power)
            gait = self._answer(asked, request.direction, request.initial_length)
        except OptimizerError as error:
            gait = GaitAnswer(RequestStatus.INVALID, str(error))
        return optimizer_messages.fill_response(response, gait)

    def _answer(self, asked: GaitRequest, direction: int, initial_length: float) -> GaitAnswer:
        """From the front, or for a robot that rests with another initial length (m) than the parameters'."""
        front, known = self._fronts.get(direction), self._content.parameters.initial_length
        if front is None or not initial_length or abs(initial_length - known) < SAME_LENGTH:
            return answer(self._fronts, self._absences, direction, asked)
        return resting_answer(front, self._content, self._settings, asked, initial_length)

    # --- actions --------------------------------------------------------------------------------

    async def _optimize(self, goal: ServerGoalHandle) -> OptimizeGaits.Result:
        content = self._content
        try:
            settings = optimizer_messages.settings_of_goal(self._settings, goal.request)
            direction = optimizer_messages.direction_of(goal.request.direction)
        except OptimizerError as error:
            goal.abort()
            return OptimizeGaits.Result(message=str(error))
        job = self._front_job(content, settings, direction, self._cache)
        outcome = await self._run(goal, job, optimizer_messages.optimize_feedback)
        front = outcome.result
        if not isinstance(front, RobustFront):
            return OptimizeGaits.Result(message=outcome.failure)
        if content is self._content:  # else the parameter file has changed under way
            self._keep_front(front)
        return optimizer_messages.optimize_result(front)

    def _keep_front(self, front: RobustFront) -> None:
        """Answers from a front, also after the next start if it can be stored."""
        for each in both_ways(front, self._content.parameters):
            self._take_front(each)
            try:
                store_current(self._content, self._settings, each, self._cache)
            except OSError as error:
                self.get_logger().error(
                    f"{_NAMES[each.direction]}: answers requests until this node ends, "
                    f"but is not kept: {error}"
                )

    async def _scan(self, goal: ServerGoalHandle) -> ScanMargin.Result:
        try:
            settings = optimizer_messages.scan_of_goal(self._settings, goal.request)
            direction = optimizer_messages.direction_of(goal.request.direction)
        except OptimizerError as error:
            goal.abort()
            return ScanMargin.Result(message=str(error))
        job = ScanJob(self._content, settings, direction, self._cache)
        outcome = await self._run(goal, job, optimizer_messages.scan_feedback)
        if not isinstance(outcome.result, PriceOfRobustness):
            return ScanMargin.Result(message=outcome.failure)
        return optimizer_messages.scan_result(outcome.result)

    async def _run(
        self, goal: ServerGoalHandle, job: Job, feedback: Callable[[Progress], Any]
    ) -> Outcome:
        """Runs a goal's job and puts the goal into its final state."""
        ended = Future()
        ticket = Ticket(
            job, lambda progress: goal.publish_feedback(feedback(progress)), ended.set_result
        )
        name = bytes(goal.goal_id.uuid)
        self._goals[name] = ticket
        self._submit(ticket)
        if goal.is_cancel_requested:  # it came before there was anything to cancel
            self._queue.cancel(ticket)
        outcome: Outcome = await ended
        del self._goals[name]
        if outcome.cancelled:
            goal.canceled()
            return Outcome(failure="cancelled", cancelled=True)
        if outcome.failure:
            goal.abort()
        else:
            goal.succeed()
        return outcome

    def _cancel(self, goal: ServerGoalHandle) -> CancelResponse:
        ticket = self._goals.get(bytes(goal.goal_id.uuid))
        if ticket is not None:
            self._queue.cancel(ticket)
        return CancelResponse.ACCEPT

    # --- the worker and the node's health -----------------------------------------------------

    def _submit(self, ticket: Ticket) -> None:
        self._queue.submit(ticket)
        self._poll_timer.reset()

    def _poll(self) -> None:
        self._queue.poll()
        if not self._queue.busy:
            self._poll_timer.cancel()

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
        if front is None:
            absence = self._absences[direction]
            failed = absence.status is RequestStatus.NO_FRONT
            status.level = DiagnosticStatus.ERROR if failed else DiagnosticStatus.WARN
            status.message = absence.message
            return status
        status.level = DiagnosticStatus.OK
        status.message = f"{len(front.predictions)} gaits"
        status.values = [
            KeyValue(key="margin_m", value=f"{front.margin:.6f}"),
            KeyValue(key="hypervolume_share", value=f"{front.hypervolume_share:.5f}"),
            KeyValue(key="source", value=front.source),
        ]
        return status


def main() -> int:
    """Runs the node until it is told to stop; 2 if its parameters cannot work."""
    return run_node(
        "optimizer_node",
        "Answers requests for gaits from robust fronts, and computes new fronts.",
        optimizer_parameters.rows,
        _run,
        (OptimizerError, ParameterError),
    )


def _run(ended: Ending) -> None:
    node = OptimizerNode()
    try:
        spin(node, ended)
    finally:
        node.close()
        node.destroy_node()
