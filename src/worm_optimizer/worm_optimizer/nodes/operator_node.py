# SPDX-License-Identifier: Apache-2.0
"""Operator actions on a robot as calls with timeouts, for `operate`, the demo, the campaign and the console.

All calls use public topics, services and actions. An operator node belongs to one thread, and a call spins the node
while it waits. A running gait is a `GaitRun`; its heartbeat needs a node that is spun.
"""

from __future__ import annotations

import os
import re
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from typing import Any, TypeVar

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.msg import Log, Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.client import Client
from rclpy.duration import Duration
from rclpy.executors import SingleThreadedExecutor
from rclpy.logging import LoggingSeverity
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.task import Future
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from worm_model.gait import FORWARD
from worm_model.twin.records import Activity, Health
from worm_msgs import network
from worm_msgs.msg import GaitState, Heartbeat, Power, Tracker, TwinResiduals, TwinState
from worm_msgs.qos import LATCHED
from worm_msgs.ros_process import words_of
from worm_msgs.srv import InjectFault, RequestGait
from worm_optimizer.nodes.action_goal import ActionGoal
from worm_optimizer.nodes.gait_run import GaitRun
from worm_optimizer.nodes.optimizer_messages import value_of
from worm_optimizer.nodes.search_goal import SearchGoal
from worm_optimizer.orders import (
    FrontOrder,
    Order,
    Progress,
    RobotState,
    RunResult,
    ScanOrder,
    SearchResult,
)
from worm_optimizer.robustness.prediction import Prediction
from worm_optimizer.search.gait_request import GaitRequest, Objective

DRIVER = "driver"  # name of the node in system.yaml
_DRIVER_SERVICE = (
    "run_gait/_action/send_goal"  # only drivers have this service, whatever their names
)
NODES_TIMEOUT_S = 120.0  # the first start of the twin includes the compilation of its kernel
DISCOVERY_TIMEOUT_S = 30.0
LEASE_S = 25.0  # DDS counts a silent participant as alive for 20 s
CALL_TIMEOUT_S = 30.0
SILENCE_S = 60.0  # timeout for feedback of a running gait
REASON_S = 1.0  # timeout for the driver's log message about a failed transition
TELEMETRY_S = 1.0  # timeout of `state` for the optional topics of power, tracker and twin
ATTEMPTS = 2  # lifecycle transitions from unconfigured to active
SPIN_S = 0.05  # longest time between two calls of `check`
_TELEMETRY: dict[type, str] = {
    Power: "power",
    Tracker: "tracker",
    TwinResiduals: "twin/residuals",
    TwinState: "twin/state",
}
_NEXT = {
    State.PRIMARY_STATE_UNCONFIGURED: Transition.TRANSITION_CONFIGURE,
    State.PRIMARY_STATE_INACTIVE: Transition.TRANSITION_ACTIVATE,
}
_STATES = {state.value: state.name for state in Activity}
_HEALTH = {health.value: health.name.lower() for health in Health}
_Goal = TypeVar("_Goal", bound=ActionGoal)


class OperatorError(RuntimeError):
    """A node did not answer in time, or rejected a request."""


class UnreachableError(OperatorError):
    """No gait of the front satisfies a request; the message names the nearest one."""


class GaitFailedError(OperatorError):
    """A gait was started and did not reach its end."""


class _NoAnswerError(OperatorError):
    """No answer arrived in time."""


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
        except (network.NetworkError, RuntimeError) as error:  # rcl's own have no public name
            raise OperatorError(f"ROS: {words_of(error)}") from None
        stack.callback(node.destroy_node)
        yield node


class OperatorNode(Node):
    """Client of the driver, the optimizer and the virtual robot in one namespace.

    Args:
        namespace: the robot's namespace.
        check: called during each wait. It may raise, for example when a node's process has ended.
        context: ROS context.
        name: name of the node.

    Attributes:
        late_cycles: deadlines that the driver has missed since its start, according to its diagnostics.
    """

    def __init__(
        self,
        namespace: str,
        check: Callable[[], None],
        context: rclpy.Context,
        name: str = "operator",
    ) -> None:
        super().__init__(name, namespace=namespace, context=context)
        self._check = check
        self._named_clients: dict[str, Client] = {}
        self.late_cycles = 0
        self._simulated_s: float | None = None  # time of a virtual robot's clock
        self._heard: dict[type, Any] = {}  # latest message of each type
        self._errors: deque[str] = deque(maxlen=20)  # errors in the driver's log
        self._watched: set[type] = set()
        self._own_runs = 0
        self.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)
        self.create_subscription(Clock, "clock", self._on_clock, 10)
        self.create_subscription(Log, "/rosout", self._on_log, 100)
        self.create_subscription(GaitState, "gait_state", self._hear, LATCHED)
        self._heartbeat = self.create_publisher(Heartbeat, "heartbeat", 10)
        self._emergency: Publisher | None = (
            None  # created by the first emergency stop of this operator
        )
        self._executor = SingleThreadedExecutor(context=context)
        self._executor.add_node(self)

    def _hear(self, message: Any) -> None:
        self._heard[type(message)] = message

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

    def destroy_node(self) -> None:
        """Destroy the node and its executor."""
        self._executor.shutdown()
        super().destroy_node()

    # --- the graph -----------------------------------------------------------------------------

    def wait_for_driver(self, timeout_s: float) -> None:
        """Wait for a message of a driver in this namespace. Raises `OperatorError` at the timeout (s)."""
        if not self.wait(lambda: GaitState in self._heard, timeout_s):
            raise OperatorError(
                f"no driver is heard in {self.get_namespace()} within {timeout_s:g} s: start one "
                "(./worm start, or ros2 launch worm_optimizer worm.launch.py), or give its namespace "
                "and ROS_DOMAIN_ID"
            )

    def wait_for_nodes(self, names: Iterable[str]) -> None:
        """Wait until these nodes exist in this namespace. Raises `OperatorError` with a missing one."""
        expected = set(names)
        if not self.wait(lambda: expected <= set(self._names()), NODES_TIMEOUT_S):
            missing = min(expected - set(self._names()))
            raise OperatorError(f"no node {missing} within {NODES_TIMEOUT_S:g} s")

    @property
    def has_lost_driver(self) -> bool:
        """True if a driver has disappeared and was not inactive according to its latest message."""
        heard = self._heard.get(GaitState)
        if heard is None or heard.state == GaitState.INACTIVE:
            return False
        return self.count_publishers(self.resolve_topic_name("gait_state")) == 0

    def _require_sole_driver(self) -> None:
        """Raise `OperatorError` if more than one driver would execute a command.

        A request reaches all services that this node has discovered, and exactly these are counted. DDS counts a
        killed process for a while after its end, so this waits up to LEASE_S.
        """
        service = self.resolve_service_name(_DRIVER_SERVICE)

        def count() -> int:
            return int(self.count_services(service))

        if not self.wait(lambda: count() <= 1, LEASE_S):
            raise OperatorError(
                f"{self.get_namespace()} has {count()} drivers, and both would move: end one of them, or use another "
                "namespace or ROS_DOMAIN_ID for it"
            )

    def wait_for_publisher(self, topic: str, remedy: str) -> None:
        """Wait until a topic has a publisher. Raises `OperatorError`, whose message contains the remedy."""
        name = self.resolve_topic_name(topic)
        if not self.wait(lambda: self.count_publishers(name) > 0, DISCOVERY_TIMEOUT_S):
            raise OperatorError(f"nobody publishes {name}: {remedy}")

    def rest(self, duration_s: float) -> None:
        """Wait for a duration (s) of the robot's time; `check` is called meanwhile."""
        end = self.robot_time_s + duration_s
        self.wait(lambda: self.robot_time_s >= end, 10.0 * duration_s + SILENCE_S)

    def wait_for_recorder(self, name: str, left_out: str = "") -> None:
        """Wait until a recorder has subscribed to all visible topics of this namespace that have publishers.

        Its recording lacks messages that were published earlier.

        Args:
            name: name of the recorder's node.
            left_out: regular expression of the topics that it does not record; empty: it records all.

        Raises:
            OperatorError: The recorder did not subscribe in time; the message names a topic.
        """

        def unheard() -> list[str]:
            topics = self._unheard_topics(name)
            return [topic for topic in topics if not (left_out and re.search(left_out, topic))]

        if not self.wait(lambda: not unheard(), DISCOVERY_TIMEOUT_S):
            raise OperatorError(f"{name} does not subscribe to {unheard()[0]}")

    def _unheard_topics(self, listener: str) -> list[str]:
        prefix = self.get_namespace() + "/"
        return [
            topic
            for topic, _ in self.get_topic_names_and_types()
            if topic.startswith(prefix)
            and "/_" not in topic
            and self.count_publishers(topic) > 0
            and listener not in [i.node_name for i in self.get_subscriptions_info_by_topic(topic)]
        ]

    def _names(self) -> list[str]:
        nodes = self.get_node_names_and_namespaces()
        return [name for name, namespace in nodes if namespace == self.get_namespace()]

    @property
    def runs_of_others(self) -> int:
        """Number of runs that other clients started. Valid if this operator is older than the driver's first run."""
        return self._runs - self._own_runs

    @property
    def _runs(self) -> int:
        heard = self._heard.get(GaitState)
        return 0 if heard is None else int(heard.run)

    # --- what a person does --------------------------------------------------------------------

    def state(self) -> RobotState:
        """Return the robot's state. Raises `OperatorError` if there is no driver."""
        for kind, topic in _TELEMETRY.items():
            if kind not in self._watched:
                self._watched.add(kind)
                self.create_subscription(kind, topic, self._hear, 10)
        self.wait_for_driver(DISCOVERY_TIMEOUT_S)
        self.wait(lambda: _TELEMETRY.keys() <= self._heard.keys(), TELEMETRY_S)
        return _state_of(self._state(DRIVER).label, self._heard)

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
        self._require_sole_driver()
        self.configure()
        return self._trigger("home")

    def reboot(self) -> str:
        """Restart the servos that have a hardware error; return the driver's report. Raises `OperatorError`."""
        self._require_sole_driver()
        return self._trigger("reboot")

    def stop(self) -> str:
        """Stop the cable where it is, immediately; return the driver's report. Raises `OperatorError`."""
        return self._trigger("stop")

    def prepare_stop(self) -> None:
        """Create the client of the stop service, so that it is discovered before it is needed."""
        self._client(Trigger, "stop")

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
            heard = self._heard.get(GaitState)
            return heard is not None and bool(heard.emergency_stop)

        if not self.wait(latched, CALL_TIMEOUT_S):
            raise OperatorError(
                f"no driver confirms the emergency stop within {CALL_TIMEOUT_S:g} s"
            )
        return "holding; nothing starts before the emergency stop is reset"

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
        response = self._call(InjectFault, "inject_fault", fault)
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
            initial_length: length of the robot at rest (m), as in `RobotState`; 0: that of the optimizer's parameters.

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
        response = self._call_twice(RequestGait, "request_gait", message)
        if response.success:
            return value_of(Prediction, response.prediction.gait, response.prediction)
        if response.status == RequestGait.Response.UNREACHABLE:
            raise UnreachableError(response.message)
        raise OperatorError(f"the optimizer has no gait: {response.message}")

    def begin(self, order: Order, wanted: Callable[[], bool] = lambda: True) -> GaitRun:
        """Start a gait. The caller must close the returned handle.

        The robot comes to rest when the heartbeats of this operator stop, or when ``wanted`` returns False. It is
        called four times a second.

        Raises:
            OperatorError: There is no driver, more than one, or no answer.
        """
        self._require_sole_driver()
        return self._sent(GaitRun(self, self._heartbeat, order, wanted))

    def search(
        self, order: ScanOrder | FrontOrder, on_end: Callable[[SearchResult], None]
    ) -> SearchGoal:
        """Start a margin scan or an optimisation. The caller must close the returned handle.

        The search runs in the background; ``on_end`` is called with its result. Raises `OperatorError` if there is no
        optimizer.
        """
        return self._sent(SearchGoal(self, order, on_end))

    def take_parameters(self, node: str, parameter_file: str) -> None:
        """Set the parameter file of a node; empty for the paper's values.

        Raises:
            OperatorError: The node rejects the file.
        """
        value = ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=parameter_file)
        request = SetParameters.Request(parameters=[Parameter(name="parameter_file", value=value)])
        answer = self._call_twice(SetParameters, f"{node}/set_parameters", request).results[0]
        if not answer.successful:
            raise OperatorError(f"{node} does not take {parameter_file}: {answer.reason}")

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
            if time.monotonic() > run.heard_at + SILENCE_S:
                raise _NoAnswerError(f"nothing is heard of the run for {SILENCE_S:g} s")
            self._spin()
            if run.progress is not None and run.progress is not last:
                last = run.progress
                progress(last)
        return run.done

    def run(self, order: Order, progress: Progress) -> RunResult:
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
                raise _NoAnswerError(f"no answer from {goal.name} within {CALL_TIMEOUT_S:g} s")
        except BaseException:
            goal.close()
            raise
        return goal

    def _trigger(self, name: str) -> str:
        response = self._call_twice(Trigger, name, Trigger.Request())
        if not response.success:
            raise OperatorError(f"{name}: {response.message}")
        return str(response.message)

    def _reason(self) -> str:
        """Return the latest error of the driver's log, or a hint to the log if none arrives."""
        self.wait(lambda: bool(self._errors), REASON_S)
        return self._errors[-1] if self._errors else "its log says why"

    def _state(self, node: str) -> State:
        answer = self._call_twice(GetState, f"{node}/get_state", GetState.Request())
        return answer.current_state

    def _change(self, node: str, transition: int) -> bool:
        self._require_sole_driver()
        request = ChangeState.Request(transition=Transition(id=transition))
        response = self._call(ChangeState, f"{node}/change_state", request)
        return bool(response.success)

    def _call_twice(self, kind: Any, name: str, request: Any) -> Any:
        """Call a service, once more if no answer arrives; on a busy computer, discovery can lose an answer."""
        try:
            return self._call(kind, name, request)
        except _NoAnswerError:
            return self._call(kind, name, request)

    def _call(self, kind: Any, name: str, request: Any) -> Any:
        client = self._client(kind, name)
        if not self.wait(client.service_is_ready, DISCOVERY_TIMEOUT_S):
            raise OperatorError(f"no service {name}")
        return self._result(client.call_async(request), name, CALL_TIMEOUT_S)

    def _client(self, kind: Any, name: str) -> Client:
        if name not in self._named_clients:  # reused, as each new client has to be discovered
            self._named_clients[name] = self.create_client(kind, name)
        return self._named_clients[name]

    def _result(self, future: Future, name: str, timeout_s: float) -> Any:
        if not self.wait(future.done, timeout_s):
            raise _NoAnswerError(f"no answer from {name} within {timeout_s:g} s")
        return future.result()

    def wait(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        """Spin until a condition holds; return False at the timeout (s)."""
        deadline = time.monotonic() + timeout_s
        while not condition():
            if time.monotonic() > deadline:
                return False
            self._spin()
        return True

    def _spin(self) -> None:
        self._check()
        self._executor.spin_once(timeout_sec=SPIN_S)


def _state_of(lifecycle: str, heard: dict[type, Any]) -> RobotState:
    gait_state = heard[GaitState]
    fields: dict[str, Any] = {}
    if (power := heard.get(Power)) is not None:
        fields["power"] = power.power
    if (tracker := heard.get(Tracker)) is not None:
        fields["rear_position"] = tracker.rear_position
    if (residuals := heard.get(TwinResiduals)) is not None:
        fields["health"] = _HEALTH.get(residuals.health, "")
    if (twin := heard.get(TwinState)) is not None:
        fields["initial_length"] = twin.initial_length
    return value_of(
        RobotState,
        gait_state,
        gait_state.gait,
        lifecycle=lifecycle,
        state=_STATES.get(gait_state.state, ""),
        **fields,
    )
