# SPDX-License-Identifier: Apache-2.0
"""Operator actions on a robot as calls with timeouts, for `operate`, the demo, the campaign and the console.

All calls use public topics, services and actions. An operator node belongs to one thread, and a call spins the node
while it waits. A running gait is a `GaitRun`; its heartbeat needs a node that is spun.
"""

from __future__ import annotations

import os
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from typing import TypeVar

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.msg import Log, Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import GetParameters, SetParametersAtomically
from rclpy.duration import Duration
from rclpy.logging import LoggingSeverity
from rclpy.publisher import Publisher
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from worm_model.conditions import CONDITION_PARAMETERS, Conditions
from worm_model.gait import FORWARD
from worm_model.twin.records import Activity
from worm_msgs import network
from worm_msgs.msg import ControlRequest, Heartbeat
from worm_msgs.qos import LATCHED
from worm_msgs.ros_process import one_line_of
from worm_msgs.srv import InjectFault, RequestGait
from worm_optimizer.nodes.action_goal import ActionGoal
from worm_optimizer.nodes.gait_run import GaitRun
from worm_optimizer.nodes.optimizer_messages import value_of
from worm_optimizer.nodes.robot_graph import RobotGraph
from worm_optimizer.nodes.robot_telemetry import Telemetry
from worm_optimizer.nodes.search_goal import SearchGoal
from worm_optimizer.nodes.service_caller import (
    CALL_TIMEOUT_S,
    DISCOVERY_TIMEOUT_S,
    NoAnswerError,
    OperatorError,
    ServiceCaller,
)
from worm_optimizer.robot_commands import (
    FrontRequest,
    GaitCommand,
    Progress,
    RunResult,
    ScanRequest,
    SearchResult,
)
from worm_optimizer.robustness.prediction import Prediction
from worm_optimizer.search.gait_request import GaitRequest, Objective
from worm_optimizer.snapshot import Snapshot, Wish

DRIVER, TWIN, OPTIMIZER = "driver", "twin", "optimizer"  # names of the nodes in system.yaml
SILENCE_S = 60.0  # timeout for feedback of a running gait
REASON_S = 1.0  # timeout for the driver's log message about a failed transition
TELEMETRY_S = 1.0  # timeout of `current_snapshot` for the topics of power, tracker and twin
ATTEMPTS = 2  # lifecycle transitions from unconfigured to active
_NEXT = {
    State.PRIMARY_STATE_UNCONFIGURED: Transition.TRANSITION_CONFIGURE,
    State.PRIMARY_STATE_INACTIVE: Transition.TRANSITION_ACTIVATE,
}
_Goal = TypeVar("_Goal", bound=ActionGoal)


class UnreachableError(OperatorError):
    """No gait of the front satisfies a request; the message names the nearest one."""


class GaitFailedError(OperatorError):
    """A gait was started and did not reach its end."""


@contextmanager
def operator(
    namespace: str, check: Callable[[], None] = lambda: None, name: str = "operator"
) -> Iterator[OperatorNode]:
    """Provide an operator node with its own ROS context, which leaves signals to Python.

    On exit the node leaves the ROS graph, also after an exception.

    Args:
        namespace: the robot's namespace.
        check: see `OperatorNode`.
        name: name of the node.

    Raises:
        OperatorError: The node cannot be created; middleware, domain or security is not available.
    """
    with ExitStack() as stack:
        context = rclpy.Context()
        stack.callback(context.try_shutdown)
        try:
            network.bind(os.environ, rclpy.get_rmw_implementation_identifier())
            context.init(args=[])
            node = OperatorNode(namespace, check, context, name)
        except (network.NetworkError, RuntimeError) as error:  # rcl's errors are not public
            raise OperatorError(f"ROS: {one_line_of(error)}") from None
        stack.callback(node.destroy_node)
        yield node


class OperatorNode(ServiceCaller):
    """Client of the driver, the optimizer and the virtual robot in one namespace.

    Args:
        namespace: the robot's namespace.
        check: called during each wait. It may raise, for example when a node's process has ended.
        context: ROS context.
        name: name of the node.

    Attributes:
        graph: the ROS graph of the robot.
        late_cycles: deadlines that the driver has missed since its start, according to its diagnostics.
    """

    def __init__(
        self,
        namespace: str,
        check: Callable[[], None],
        context: rclpy.Context,
        name: str = "operator",
    ) -> None:
        super().__init__(name, namespace, context, check)
        self.graph = RobotGraph(self)
        self.late_cycles = 0
        self._simulated_s: float | None = None  # time of a virtual robot's clock
        self._telemetry = Telemetry(self)
        self._errors: deque[str] = deque(maxlen=20)  # errors in the driver's log
        self._own_runs = 0
        self.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)
        self.create_subscription(Clock, "clock", self._on_clock, 10)
        self.create_subscription(Log, "/rosout", self._on_log, 100)
        self._heartbeat = self.create_publisher(Heartbeat, "heartbeat", 10)
        self._control = self.create_publisher(ControlRequest, "control/request", 100)
        self._emergency: Publisher | None = (
            None  # created by the first emergency stop of this operator
        )

    def _on_log(self, message: Log) -> None:
        own = f"{self.get_namespace()}/{DRIVER}".strip("/").replace("/", ".")
        if message.name == own and message.level >= LoggingSeverity.ERROR:
            self._errors.append(message.msg)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        own = self.get_namespace().strip("/")
        for status in message.status:
            if status.name == f"{own}/driver: timing":
                values = {value.key: value.value for value in status.values}
                self.late_cycles = int(values.get("missed_deadlines", 0))

    def _on_clock(self, message: Clock) -> None:
        self._simulated_s = message.clock.sec + 1e-9 * message.clock.nanosec

    @property
    def robot_time_s(self) -> float:
        """Time of the virtual robot in this namespace (s); without one, the computer's monotonic time."""
        return time.monotonic() if self._simulated_s is None else self._simulated_s

    # --- the state of the robot ----------------------------------------------------------------

    def wait_for_driver(self, timeout_s: float) -> None:
        """Wait for a message of a driver in this namespace. Raises `OperatorError` at the timeout (s)."""
        if not self.wait(lambda: self._telemetry.driver is not None, timeout_s):
            raise OperatorError(
                f"no driver in {self.get_namespace()} within {timeout_s:g} s: start one "
                "(./worm start, or ros2 launch worm_optimizer worm.launch.py), or give its namespace "
                "and ROS_DOMAIN_ID"
            )

    def subscribe_to_all(self) -> None:
        """Subscribe to all topics of `snapshot`."""
        self._telemetry.subscribe_to_all()

    def snapshot(self) -> Snapshot:
        """Return what was received of the robot. Other threads may call this."""
        return self._telemetry.snapshot()

    def current_snapshot(self) -> Snapshot:
        """Return the state of the robot after a wait for all its topics. Raises `OperatorError` without a driver.

        Topics that are not published are missing after TELEMETRY_S.
        """
        self.subscribe_to_all()
        self.wait_for_driver(DISCOVERY_TIMEOUT_S)
        self.wait(lambda: self._telemetry.is_complete, TELEMETRY_S)
        return self.snapshot()

    def lifecycle_state(self) -> str:
        """Return the primary lifecycle state of the driver, such as ``active``. Raises `OperatorError`."""
        return str(self._state(DRIVER).label)

    @property
    def has_driver(self) -> bool:
        """True if a driver is in the graph."""
        return self.graph.publishers("gait_state") > 0

    @property
    def has_lost_driver(self) -> bool:
        """True if a driver has disappeared, and its latest message did not report it as inactive."""
        driver = self._telemetry.driver
        return driver is not None and driver.state is not Activity.INACTIVE and not self.has_driver

    def rest(self, duration_s: float) -> None:
        """Wait for a duration (s) of the robot's time, and call `check` during the wait."""
        end = self.robot_time_s + duration_s
        self.wait(lambda: self.robot_time_s >= end, 10.0 * duration_s + SILENCE_S)

    @property
    def runs_of_others(self) -> int:
        """Number of runs that other clients started. Valid if this operator is older than the driver's first run."""
        return self._runs - self._own_runs

    @property
    def _runs(self) -> int:
        driver = self._telemetry.driver
        return 0 if driver is None else driver.run

    # --- what a person does --------------------------------------------------------------------

    def activate(self) -> str:
        """Configure and activate the driver; return a report. Raises `OperatorError` if it does not become active."""
        asked = 0
        while (state := self._state(DRIVER)).id != State.PRIMARY_STATE_ACTIVE:
            if state.id not in _NEXT or asked == ATTEMPTS:
                raise OperatorError(f"{DRIVER} stays {state.label}: {self._reason()}")
            asked += 1
            self._errors.clear()
            self._change(DRIVER, _NEXT[state.id])
        return "the driver is active, its torque is on"

    def configure(self) -> None:
        """Configure the driver if it is unconfigured. Raises `OperatorError` if that fails."""
        if self._state(DRIVER).id == State.PRIMARY_STATE_UNCONFIGURED:
            self._errors.clear()
            if not self._change(DRIVER, Transition.TRANSITION_CONFIGURE):
                raise OperatorError(f"{DRIVER} cannot be configured: {self._reason()}")

    def deactivate(self) -> str:
        """Deactivate an active driver, which comes to rest and releases torque; return a report.

        Raises:
            OperatorError: The driver stays active.
        """
        if self._state(DRIVER).id == State.PRIMARY_STATE_ACTIVE:
            self._errors.clear()
            if not self._change(DRIVER, Transition.TRANSITION_DEACTIVATE):
                raise OperatorError(f"{DRIVER} does not deactivate: {self._reason()}")
        return "the robot is at rest, its torque is off"

    def home(self) -> str:
        """Define the present cable length as ΔL = 0; return the driver's report. Raises `OperatorError`."""
        self.graph.require_sole_driver()
        self.configure()
        return self._trigger("home")

    def reboot(self) -> str:
        """Restart the servos that have a hardware error; return the driver's report. Raises `OperatorError`."""
        self.graph.require_sole_driver()
        return self._trigger("reboot")

    def stop(self) -> str:
        """Stop the cable where it is, immediately; return the driver's report. Raises `OperatorError`."""
        return self._trigger("stop")

    def prepare_stop(self) -> None:
        """Create the client of the stop service, so that it is discovered before it is needed."""
        self.named_client(Trigger, "stop")

    def emergency_stop(self) -> str:
        """Hold immediately and reject all starts until the reset; return a report.

        Raises:
            OperatorError: The driver did not confirm the emergency stop in time.
        """
        if self._emergency is None:
            self._emergency = self.create_publisher(Bool, "emergency_stop", LATCHED)
        publisher = self._emergency

        def latched() -> bool:
            publisher.publish(Bool(data=True))
            driver = self._telemetry.driver
            return driver is not None and driver.emergency_stop

        if not self.wait(latched, CALL_TIMEOUT_S):
            raise OperatorError(
                f"no driver confirms the emergency stop within {CALL_TIMEOUT_S:g} s"
            )
        return "holding; nothing starts before the emergency stop is reset"

    def request_control(self, client: str, wish: Wish, lease_s: float) -> None:
        """Publish a client's request about the control of the robot. `Snapshot.control` has the answer."""
        self._control.publish(ControlRequest(client=client, wish=wish, lease_s=lease_s))

    def reset_emergency_stop(self) -> str:
        """Permit starts again; return the driver's report.

        Raises:
            OperatorError: The driver rejects the reset, because the latest message of another publisher is true.
        """
        if self._emergency is not None:
            self._emergency.publish(Bool(data=False))
            self._emergency.wait_for_all_acked(Duration(seconds=CALL_TIMEOUT_S))
        return self._trigger("reset_emergency_stop")

    def inject_fault(self, name: str, **details: float) -> str:
        """Inject a fault into the virtual robot; return a description of its effect.

        Args:
            name: name of the fault.
            details: further fields of InjectFault: target, delay, duration, count, value.

        Raises:
            OperatorError: The virtual robot rejects the fault or does not answer.
        """
        fault = InjectFault.Request(name=name, **details)
        response = self.call(InjectFault, "inject_fault", fault)
        if not response.success:
            raise OperatorError(response.message)
        return str(response.message)

    def request_gait(
        self,
        request: GaitRequest,
        direction: int = FORWARD,
        initial_length: float = 0.0,
    ) -> Prediction:
        """Request a gait from the optimizer.

        Args:
            request: objective and its value.
            direction: FORWARD or REVERSE.
            initial_length: L0 (m), for example that of the twin's state; 0: that of the optimizer's parameters.

        Raises:
            UnreachableError: No gait of the front satisfies the request.
            OperatorError: There is no gait for another reason, which the message contains.
        """
        message = RequestGait.Request(
            objective=int(request.objective), direction=direction, initial_length=initial_length
        )
        if request.objective is Objective.MIN_POWER_AT_SPEED:
            message.speed = request.value
        elif request.objective is Objective.MAX_SPEED_AT_POWER:
            message.power = request.value
        response = self.call_twice(RequestGait, "request_gait", message)
        if response.success:
            return value_of(Prediction, response.prediction.gait, response.prediction)
        if response.status == RequestGait.Response.UNREACHABLE:
            raise UnreachableError(response.message)
        raise OperatorError(f"the optimizer has no gait: {response.message}")

    def begin(self, order: GaitCommand, wanted: Callable[[], bool] = lambda: True) -> GaitRun:
        """Start a gait. The caller must close the returned handle.

        The robot comes to rest when the heartbeats of this operator stop, or when ``wanted`` returns False.
        ``wanted`` is called four times a second.

        Raises:
            OperatorError: There is no driver, more than one, or no answer.
        """
        self.graph.require_sole_driver()
        return self._sent(GaitRun(self, self._heartbeat, order, wanted))

    def search(
        self, order: ScanRequest | FrontRequest, on_end: Callable[[SearchResult], None]
    ) -> SearchGoal:
        """Start a margin scan or an optimisation. The caller must close the returned handle.

        The search runs in the background; ``on_end`` is called with its result. Raises `OperatorError` if there is no
        optimizer.
        """
        return self._sent(SearchGoal(self, order, on_end))

    def set_parameters(self, node: str, values: Mapping[str, str | float]) -> None:
        """Set parameters of a node, all or none.

        Raises:
            OperatorError: The node rejects a value.
        """
        parameters = [Parameter(name=name, value=_value(value)) for name, value in values.items()]
        request = SetParametersAtomically.Request(parameters=parameters)
        service = f"{node}/set_parameters_atomically"
        answer = self.call_twice(SetParametersAtomically, service, request).result
        if not answer.successful:
            raise OperatorError(f"{node} rejects new parameters: {answer.reason}")

    def set_model_parameters(self, values: Mapping[str, str | float]) -> None:
        """Set parameters of twin and optimizer, such as their parameter file and the conditions in the pipe.

        Raises:
            OperatorError: A node rejects a value; the message says if the twin has accepted it.
        """
        self.set_parameters(TWIN, values)
        try:
            self.set_parameters(OPTIMIZER, values)
        except OperatorError as error:
            raise OperatorError(f"only the twin uses the new parameters: {error}") from None

    def conditions(self) -> Conditions:
        """Return the conditions that the optimizer assumes. Raises `OperatorError` if there is no optimizer."""
        request = GetParameters.Request(names=list(CONDITION_PARAMETERS))
        answer = self.call_twice(GetParameters, f"{OPTIMIZER}/get_parameters", request)
        values = (value.double_value for value in answer.values)
        return Conditions(**dict(zip(CONDITION_PARAMETERS.values(), values, strict=True)))

    def follow(
        self, run: GaitRun, progress: Progress, until: Callable[[], bool] = lambda: False
    ) -> bool:
        """Wait until a run ends or a condition holds; return True if the run has ended.

        Args:
            run: the run.
            progress: called with each new feedback.
            until: the condition.

        Raises:
            OperatorError: No feedback arrived for SILENCE_S. There is no limit on the whole run, because a virtual
                robot's time may be slower than this computer's.
        """
        last = None
        while not run.done and not until():
            if time.monotonic() > run.received_at + SILENCE_S:
                raise NoAnswerError(f"no feedback of the run for {SILENCE_S:g} s")
            self.spin()
            if run.progress is not None and run.progress is not last:
                last = run.progress
                progress(last)
        return run.done

    def run(self, order: GaitCommand, progress: Progress) -> RunResult:
        """Run a gait to its end and return its result.

        Raises:
            GaitFailedError: The driver rejected the gait, or it did not reach its end.
            OperatorError: There is no driver, more than one, or no answer.
        """
        before = self._runs
        run = self.begin(order)
        try:
            self.follow(run, progress)
            result = run.result
        finally:
            run.close()
            self._own_runs += min(self._runs - before, 1)
        if not result.success:
            raise GaitFailedError(f"the gait failed: {result.message}")
        return result

    # --- calls ---------------------------------------------------------------------------------

    def _sent(self, goal: _Goal) -> _Goal:
        """Send a goal and return it after its acceptance or rejection; close it if there is no answer."""
        try:
            if not self.wait(lambda: goal.possible, DISCOVERY_TIMEOUT_S):
                raise OperatorError(f"no action {goal.name}")
            goal.send()
            if not self.wait(lambda: goal.answered, CALL_TIMEOUT_S):
                raise NoAnswerError(f"no answer from {goal.name} within {CALL_TIMEOUT_S:g} s")
        except BaseException:
            goal.close()
            raise
        return goal

    def _trigger(self, name: str) -> str:
        response = self.call_twice(Trigger, name, Trigger.Request())
        if not response.success:
            raise OperatorError(f"{name}: {response.message}")
        return str(response.message)

    def _reason(self) -> str:
        """Return the latest error of the driver's log, or a hint to the log if none arrives."""
        self.wait(lambda: bool(self._errors), REASON_S)
        return self._errors[-1] if self._errors else "its log says why"

    def _state(self, node: str) -> State:
        answer = self.call_twice(GetState, f"{node}/get_state", GetState.Request())
        return answer.current_state

    def _change(self, node: str, transition: int) -> bool:
        self.graph.require_sole_driver()
        request = ChangeState.Request(transition=Transition(id=transition))
        response = self.call(ChangeState, f"{node}/change_state", request)
        return bool(response.success)


def _value(value: str | float) -> ParameterValue:
    if isinstance(value, str):
        return ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=value)
    return ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=float(value))
