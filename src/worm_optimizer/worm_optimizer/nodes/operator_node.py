# SPDX-License-Identifier: Apache-2.0
"""Operator actions on a robot as calls with timeouts, for `operate`, the demo, the campaign and the console.

All calls use public topics, services and actions. Only one thread may use an operator node. A call spins the node while
it waits. A running gait is a `GaitRun`, whose heartbeats are sent only while the node spins.
"""

from __future__ import annotations

import dataclasses
import os
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from functools import cached_property
from typing import Any

import rclpy
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.msg import Log
from rcl_interfaces.srv import GetParameters, SetParametersAtomically
from rclpy.logging import LoggingSeverity
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from worm_model.errors import InputError
from worm_model.gait import FORWARD, Gait
from worm_model.run import Activity
from worm_msgs import network
from worm_msgs.conditions import CONDITION_ROWS, Conditions
from worm_msgs.msg import Gait as GaitMessage
from worm_msgs.msg import Heartbeat
from worm_msgs.ros_process import one_line_of
from worm_msgs.srv import InjectFault, RequestGait
from worm_optimizer.gait_prediction import Prediction
from worm_optimizer.nodes.gait_run import GaitRun
from worm_optimizer.nodes.robot_client import (
    CALL_TIMEOUT_S,
    DISCOVERY_TIMEOUT_S,
    OperatorError,
    RobotClient,
)
from worm_optimizer.nodes.robot_telemetry import Telemetry, value_of
from worm_optimizer.robot_commands import GaitCommand, Progress, RunResult, Snapshot
from worm_optimizer.search.gait_request import GaitRequest, Objective

REQUEST_GAIT = "request_gait"
DRIVER, TWIN, OPTIMIZER = "driver", "twin", "optimizer"  # names of the nodes in system.yaml
SILENCE_S = 60.0  # timeout for feedback of a running gait, s
REASON_S = 1.0  # timeout for the driver's log message about a failed transition, s
REPEATED_S = 1.0  # s, time after the reset in which a pressed button repeats the emergency stop
TELEMETRY_S = 1.0  # timeout of `current_snapshot` for power, tracker and twin, s
OPTIMIZER_S = 5.0  # timeout for the discovery of an optimizer, which may be missing, s
_CONFIGURE = State.PRIMARY_STATE_UNCONFIGURED, Transition.TRANSITION_CONFIGURE
_ACTIVATE = State.PRIMARY_STATE_INACTIVE, Transition.TRANSITION_ACTIVATE


class GaitFailedError(OperatorError):
    """The driver rejected a gait, or a gait did not reach its end."""


class RejectedStartError(OperatorError):
    """The driver rejected a gait because of its present state, so nothing moved."""


@contextmanager
def operator(
    namespace: str, check: Callable[[], None] = lambda: None, name: str = "operator"
) -> Iterator[OperatorNode]:
    """Provide an operator node with its own ROS context, which installs no signal handlers.

    When the context manager ends, also with an exception, the node leaves the ROS graph.

    Args:
        namespace: the robot's namespace.
        check: see `OperatorNode`.
        name: name of the node.

    Raises:
        OperatorError: The node cannot be created, because middleware, domain or security is unavailable.
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


class OperatorNode(RobotClient):
    """Client of the driver, the optimizer and the virtual robot in one namespace.

    Args:
        namespace: the robot's namespace.
        check: called during each wait. It may raise, for example when a node's process has ended.
        context: ROS context.
        name: name of the node.

    Attributes:
        telemetry: latest state of the robot.
    """

    def __init__(
        self,
        namespace: str,
        check: Callable[[], None],
        context: rclpy.Context,
        name: str = "operator",
    ) -> None:
        super().__init__(name, namespace, context, check)
        self._simulated_s: float | None = None  # time of a virtual robot's clock
        self.telemetry = Telemetry(self)
        self._errors: deque[str] = deque(maxlen=20)  # errors in the driver's log
        self.create_subscription(Clock, "clock", self._on_clock, 10)
        self.create_subscription(Log, "/rosout", self._on_log, 100)
        self._heartbeat = self.create_publisher(Heartbeat, "heartbeat", 10)

    def _on_log(self, message: Log) -> None:
        own = f"{self.get_namespace()}/{DRIVER}".strip("/").replace("/", ".")
        if message.name == own and message.level >= LoggingSeverity.ERROR:
            self._errors.append(message.msg)

    def _on_clock(self, message: Clock) -> None:
        self._simulated_s = message.clock.sec + 1e-9 * message.clock.nanosec

    @property
    def robot_time_s(self) -> float:
        """Time of the virtual robot in this namespace, s; without a virtual robot, time of the monotonic clock, s."""
        return time.monotonic() if self._simulated_s is None else self._simulated_s

    # --- the state of the robot ----------------------------------------------------------------

    def wait_for_driver(self, timeout_s: float) -> None:
        """Wait for a message of a driver in this namespace. Raises `OperatorError` at the timeout (s)."""
        if not self.wait(lambda: self.telemetry.driver is not None, timeout_s):
            raise OperatorError(
                f"no driver in {self.get_namespace()} within {timeout_s:g} s: start one "
                "(./worm start, or ros2 launch worm_optimizer worm.launch.py), or give its namespace "
                "and ROS_DOMAIN_ID"
            )

    def current_snapshot(self) -> Snapshot:
        """Wait up to `TELEMETRY_S` for a message of each measurement, and return the state of the robot."""
        self.telemetry.subscribe_to_all()
        self.wait(lambda: self.telemetry.is_complete, TELEMETRY_S)
        return self.telemetry.snapshot()

    def lifecycle_state(self) -> str:
        """Return the primary lifecycle state of the driver, such as ``active``. Raises `OperatorError`."""
        return str(self._state().label)

    @property
    def has_driver(self) -> bool:
        """True if the ROS graph of the robot contains a driver."""
        return bool(self.count_publishers("gait_state") > 0)

    @property
    def has_lost_driver(self) -> bool:
        """True if the driver has disappeared and its latest message did not report the state inactive."""
        driver = self.telemetry.driver
        return driver is not None and driver.state is not Activity.INACTIVE and not self.has_driver

    def rest(self, duration_s: float) -> None:
        """Spin the node for a duration (s) of the robot's time. If that time stands still, return at a timeout."""
        end = self.robot_time_s + duration_s
        self.wait(lambda: self.robot_time_s >= end, 10.0 * duration_s + SILENCE_S)

    @property
    def run_number(self) -> int:
        """Number of the driver's latest run, whoever has started it; 0 before its first run."""
        driver = self.telemetry.driver
        return 0 if driver is None else driver.run

    def require_tracker(self) -> None:
        """Wait until a tracker publishes. Raises `OperatorError` without one."""
        if not self.wait(lambda: self.count_publishers("tracker") > 0, DISCOVERY_TIMEOUT_S):
            raise OperatorError(
                f"{self.resolve_topic_name('tracker')} has no publisher: without it neither speed nor margin can be "
                "measured: start the tracker in the robot's namespace"
            )

    # --- commands ------------------------------------------------------------------------------

    def activate(self) -> str:
        """Configure and activate the driver; return a report. Raises `OperatorError` if it does not become active."""
        for origin, transition in (_CONFIGURE, _ACTIVATE):
            if self._state().id == origin:
                self._change(transition)
        if (state := self._state()).id != State.PRIMARY_STATE_ACTIVE:
            raise OperatorError(f"{DRIVER} stays {state.label}: {self._reason()}")
        return "the driver is active, its torque is on"

    def deactivate(self) -> str:
        """Deactivate the driver if it is active, and return a report with the driver's errors meanwhile.

        The robot comes to rest before the driver releases the torque, except in FAULT.

        Raises:
            OperatorError: The driver remains active.
        """
        self._errors.clear()
        is_active = self._state().id == State.PRIMARY_STATE_ACTIVE
        if is_active and not self._change(Transition.TRANSITION_DEACTIVATE):
            raise OperatorError(f"{DRIVER} does not deactivate: {self._reason()}")
        return "; ".join(("the torque is off", *self._errors))

    def home(self) -> str:
        """Define the present cable length as ΔL = 0; return the driver's report. Raises `OperatorError`."""
        self.require_sole_driver()
        origin, transition = _CONFIGURE
        if self._state().id == origin and not self._change(transition):
            raise OperatorError(f"{DRIVER} cannot be configured: {self._reason()}")
        return self._trigger("home")

    def reboot(self) -> str:
        """Restart the servos that have a hardware error; return the driver's report. Raises `OperatorError`."""
        self.require_sole_driver()
        return self._trigger("reboot")

    def stop(self) -> str:
        """Hold cable and fins where they are, immediately; return the driver's report. Raises `OperatorError`."""
        return self._trigger("stop")

    def prepare_stop(self) -> None:
        """Create the client of the stop service, so that `stop` does not have to wait for its discovery."""
        self.named_client(Trigger, "stop")

    def emergency_stop(self) -> str:
        """Hold immediately and reject all starts until the reset; return a report.

        Raises:
            OperatorError: The driver did not confirm the emergency stop in time.
        """

        def latched() -> bool:
            self._emergency.publish(Bool(data=True))
            return self._is_stopped()

        if not self.wait(latched, CALL_TIMEOUT_S):
            raise OperatorError(
                f"no driver confirms the emergency stop within {CALL_TIMEOUT_S:g} s"
            )
        return "holding; nothing starts before the emergency stop is reset"

    def reset_emergency_stop(self) -> str:
        """Withdraw the emergency stop and permit starts again; return the driver's report."""
        response = Trigger.Response()

        def is_reset() -> bool:
            nonlocal response
            self._emergency.publish(Bool(data=False))
            response = self.call(Trigger, "reset_emergency_stop", Trigger.Request())
            return bool(response.success)

        if not self.wait(is_reset, REPEATED_S):  # the message may arrive after the first requests
            raise OperatorError(f"reset_emergency_stop: {response.message}")
        self.wait(lambda: not self._is_stopped(), REPEATED_S)
        if self.wait(self._is_stopped, REPEATED_S):
            raise OperatorError(
                "the emergency stop was reset and is on again: release the button that repeats it"
            )
        return str(response.message)

    @cached_property
    def _emergency(self) -> Publisher:
        return self.create_publisher(Bool, "emergency_stop", 10)

    def _is_stopped(self) -> bool:
        driver = self.telemetry.driver
        return driver is not None and driver.emergency_stop

    def inject_fault(self, name: str, **details: float) -> str:
        """Inject a fault into the virtual robot; return a description of its effect.

        Args:
            name: name of the fault.
            details: other fields of the request InjectFault: target, delay, duration, count, value.
        """
        fault = InjectFault.Request(name=name, **details)
        response = self.call(InjectFault, "inject_fault", fault, attempts=1)
        if not response.success:
            raise OperatorError(response.message)
        return str(response.message)

    def has_optimizer(self) -> bool:
        """Wait up to `OPTIMIZER_S` for an optimizer; return True if there is one."""
        client = self.named_client(RequestGait, REQUEST_GAIT)
        return self.wait(client.service_is_ready, OPTIMIZER_S)

    def request_gait(
        self, request: GaitRequest, direction: int = FORWARD, initial_length: float = 0.0
    ) -> tuple[Prediction, str]:
        """Request a gait; return it with the margin of its front and warnings, which are separated by semicolons.

        Args:
            request: objective, and its value if it needs one.
            direction: FORWARD or REVERSE.
            initial_length: L0, m, for example that of the twin's state; 0 for that of the optimizer's parameters.

        Raises:
            InputError: No gait of the front satisfies the request. The message describes the nearest gait.
            OperatorError: The optimizer does not answer, or returns no gait for another reason.
        """
        values = {Objective.MIN_POWER_AT_SPEED: "speed", Objective.MAX_SPEED_AT_POWER: "power"}
        value = {values[request.objective]: request.value} if request.objective in values else {}
        return self._predicted(initial_length, int(request.objective), direction=direction, **value)

    def predict_gait(self, gait: Gait, initial_length: float = 0.0) -> tuple[Prediction, str]:
        """Return the optimizer's prediction of a gait, and its warnings about this gait.

        Args:
            gait: the gait.
            initial_length: L0, m; 0 for that of the optimizer's parameters.

        Raises `OperatorError` if the gait cannot be predicted, or without an answer.
        """
        message = GaitMessage(**dataclasses.asdict(gait))
        return self._predicted(initial_length, RequestGait.Request.GIVEN, gait=message)

    def _predicted(
        self, initial_length: float, objective: int, **details: Any
    ) -> tuple[Prediction, str]:
        message = RequestGait.Request(initial_length=initial_length, objective=objective, **details)
        response = self.call(RequestGait, REQUEST_GAIT, message)
        if response.status == RequestGait.Response.UNREACHABLE:
            raise InputError(response.message)
        if not response.success:
            raise OperatorError(f"the optimizer has no prediction: {response.message}")
        prediction = value_of(Prediction, response.prediction.gait, response.prediction)
        return prediction, response.message

    def set_model_parameters(self, values: Mapping[str, float]) -> None:
        """Set parameters of twin and optimizer, such as the conditions in the pipe; a node sets all of them or none."""
        parameters = [Parameter(n, value=float(v)).to_parameter_msg() for n, v in values.items()]
        request = SetParametersAtomically.Request(parameters=parameters)
        for node, accepted in ((TWIN, ""), (OPTIMIZER, "only the twin uses the new parameters: ")):
            try:
                service = f"{node}/set_parameters_atomically"
                answer = self.call(SetParametersAtomically, service, request).result
            except OperatorError as error:
                raise OperatorError(f"{accepted}{error}") from None
            if not answer.successful:
                raise OperatorError(f"{accepted}{node} rejects new parameters: {answer.reason}")

    def conditions(self) -> Conditions:
        """Return the conditions that the optimizer assumes. Raises `OperatorError` without an optimizer."""
        values = self.numbers(OPTIMIZER, CONDITION_ROWS)
        return Conditions(**dict(zip(CONDITION_ROWS, values, strict=True)))

    def numbers(self, node: str, names: Iterable[str]) -> list[float]:
        """Return parameters of a node that are floating-point numbers. Raises `OperatorError` without an answer."""
        request = GetParameters.Request(names=list(names))
        answer = self.call(GetParameters, f"{node}/get_parameters", request)
        return [value.double_value for value in answer.values]

    @contextmanager
    def started(
        self, command: GaitCommand, wanted: Callable[[], bool] = lambda: True
    ) -> Iterator[GaitRun]:
        """Start a gait, and provide its run, whose heartbeats end with this context.

        This operator sends heartbeats while its node spins. Before each heartbeat it calls ``wanted``. If ``wanted``
        returns False, no heartbeat is sent. Without heartbeats, the robot comes to rest.
        """
        self.require_sole_driver()
        run = GaitRun(self, self._heartbeat, command, wanted)
        try:
            if not self.wait(lambda: run.possible, DISCOVERY_TIMEOUT_S):
                raise OperatorError(f"no server of run_gait within {DISCOVERY_TIMEOUT_S:g} s")
            run.send()
            if not self.wait(lambda: run.answered, CALL_TIMEOUT_S):
                raise OperatorError(f"no answer from run_gait within {CALL_TIMEOUT_S:g} s")
            yield run
        finally:
            run.close()

    def follow(
        self, run: GaitRun, progress: Progress, until: Callable[[], bool] = lambda: False
    ) -> bool:
        """Wait until a run ends or a condition holds; return True if the run has ended.

        The whole run has no timeout, because the time of a virtual robot may advance more slowly than that of the
        computer.

        Args:
            run: the run.
            progress: called with each new feedback.
            until: the condition.
        """
        last = None
        while not run.done and not until():
            if time.monotonic() > run.received_at + SILENCE_S:
                raise OperatorError(f"no feedback of the run for {SILENCE_S:g} s")
            self.spin()
            if run.progress is not None and run.progress is not last:
                last = run.progress
                progress(last)
        return run.done

    def run(self, command: GaitCommand, progress: Progress) -> RunResult:
        """Run a gait to its end and return its result.

        Raises:
            GaitFailedError: The driver rejected the gait, or it did not reach its end.
            OperatorError: There is no driver, there are several, or the driver does not answer.
        """
        with self.started(command) as run:
            self.follow(run, progress)
        if not run.result.success:
            raise GaitFailedError(f"the gait failed: {run.result.message}")
        return run.result

    # --- calls ---------------------------------------------------------------------------------

    def _trigger(self, name: str) -> str:
        response = self.call(Trigger, name, Trigger.Request())
        if not response.success:
            raise OperatorError(f"{name}: {response.message}")
        return str(response.message)

    def _reason(self) -> str:
        """Wait for an error in the driver's log and return it. If none arrives, return a reference to the log."""
        self.wait(lambda: bool(self._errors), REASON_S)
        return self._errors[-1] if self._errors else "see its log for the reason"

    def _state(self) -> State:
        """Return the lifecycle state of the driver."""
        return self.call(GetState, f"{DRIVER}/get_state", GetState.Request()).current_state

    def _change(self, transition: int) -> bool:
        """Request a transition of the driver, whose errors from now on are kept; return True if it succeeds."""
        self.require_sole_driver()
        self._errors.clear()
        request = ChangeState.Request(transition=Transition(id=transition))
        response = self.call(ChangeState, f"{DRIVER}/change_state", request, attempts=1)
        return bool(response.success)
