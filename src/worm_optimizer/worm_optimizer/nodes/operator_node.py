# SPDX-License-Identifier: Apache-2.0
"""What a person does with a robot, as calls with deadlines: used by `operate`, the demo, the campaign and the console.

All of it goes over the topics, services and actions that `ros2` would use. One thread owns an operator; a call waits
by spinning it. A gait that runs is a `GaitRun`: begin it, follow it, and spin as long as it is to go on.
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
from rclpy.executors import SingleThreadedExecutor
from rclpy.logging import LoggingSeverity
from rclpy.node import Node
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

DRIVER = "driver"  # the node's name in system.yaml
NODES_TIMEOUT_S = 120.0  # a twin whose kernel is not compiled yet does that first
DISCOVERY_TIMEOUT_S = 30.0
LEASE_S = 25.0  # DDS believes for 20 s that a participant lives which says nothing any more
CALL_TIMEOUT_S = 30.0
SILENCE_S = 60.0  # without a word of a gait that runs, after which it has failed
OPTIMIZER_TIMEOUT_S = 120.0  # it may still be searching its front
REQUEST_PERIOD_S = 1.0
REASON_S = 1.0  # for which the driver's own word on a failed transition is waited for
TELEMETRY_S = 1.0  # for which state waits for what need not be there: power, tracker, twin
ATTEMPTS = 2  # at transitions of a lifecycle node: from unconfigured to active
SPIN_S = 0.05
STRANGER_S = 2.0  # in which a driver that is there already has been discovered
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
    """A node did not answer in time, or refused."""


class UnreachableError(OperatorError):
    """No gait of the front is what was asked for; the message tells the nearest one that is there."""


class GaitFailedError(OperatorError):
    """A gait was begun, and not brought to its end."""


class _NoAnswerError(OperatorError):
    """Nothing came back in time."""


@contextmanager
def operator(
    namespace: str, check: Callable[[], None] = lambda: None, name: str = "operator"
) -> Iterator[OperatorNode]:
    """An operator's node with a ROS context of its own, in which signals stay Python's.

    Nothing of it is announced in the ROS graph afterwards, whatever happened.

    Raises:
        OperatorError: there can be no node: its middleware, its domain or its security cannot be had.
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
    """Calls the services and actions of the driver, the optimizer and the virtual robot in its own namespace.

    ``late_cycles`` is how many deadlines the driver says that it has missed since its start.
    ``check`` is called while waiting and may raise, such as when a node's process has died.
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
        self._simulated_s: float | None = None  # by the clock of a virtual robot
        self._heard: dict[type, Any] = {}  # the last message of each type
        self._errors: deque[str] = deque(maxlen=20)  # of the driver's log
        self._watched: set[type] = set()
        self._own_runs = 0
        self.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)
        self.create_subscription(Clock, "clock", self._on_clock, 10)
        self.create_subscription(Log, "/rosout", self._on_log, 100)
        self.create_subscription(GaitState, "gait_state", self._hear, LATCHED)
        self._heartbeat = self.create_publisher(Heartbeat, "heartbeat", 10)
        self._emergency = self.create_publisher(Bool, "emergency_stop", LATCHED)
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
        """The time of the virtual robot in this namespace (s) if there is one, else the computer's, monotonic."""
        return time.monotonic() if self._simulated_s is None else self._simulated_s

    def destroy_node(self) -> None:
        """End the node and what spins it."""
        self._executor.shutdown()
        super().destroy_node()

    # --- the graph -----------------------------------------------------------------------------

    def wait_for_driver(self, timeout_s: float) -> None:
        """Wait until a driver is heard in this namespace; raises `OperatorError` if none is."""
        if not self.wait(lambda: GaitState in self._heard, timeout_s):
            raise OperatorError(
                f"no driver is heard in {self.get_namespace()} within {timeout_s:g} s: start one "
                "(./worm start, or ros2 launch worm_optimizer worm.launch.py), or give its namespace "
                "and ROS_DOMAIN_ID"
            )

    def refuse_second_driver(self) -> None:
        """Raise `OperatorError` if the robot of this namespace has its driver already.

        A process that was killed is announced for a while after its end, and is waited for.
        """
        topic = self.resolve_topic_name("gait_state")
        self.wait(lambda: self.count_publishers(topic) > 0, STRANGER_S)
        if not self.wait(lambda: self.count_publishers(topic) == 0, LEASE_S):
            raise self._another_worm(f"{self.get_namespace()} has a driver already")

    def wait_for_nodes(self, names: Iterable[str]) -> None:
        """Wait until these nodes are there; raises `OperatorError` if one is not, or is there twice.

        Two nodes of one name in this ROS domain mean that another worm runs, and commands would reach
        both; those of a process that was killed go after a while.
        """
        expected = set(names)
        self.wait(lambda: expected <= set(self._names()), NODES_TIMEOUT_S)
        missing = sorted(expected - set(self._names()))
        if missing:
            raise OperatorError(f"no node {missing[0]} within {NODES_TIMEOUT_S:g} s")
        if not self.wait(lambda: not self._repeated(expected), LEASE_S):
            names = ", ".join(sorted(self._names()))
            raise self._another_worm(f"the nodes of {self.get_namespace()} are {names}")

    def _repeated(self, names: set[str]) -> list[str]:
        current = self._names()
        return [name for name in names if current.count(name) > 1]

    @staticmethod
    def _another_worm(sign: str) -> OperatorError:
        return OperatorError(
            f"another worm runs in this ROS domain: {sign}; end it, or set ROS_DOMAIN_ID to another number for one "
            "of them"
        )

    def wait_for_publisher(self, topic: str, remedy: str) -> None:
        """Wait until somebody publishes a topic; raises `OperatorError`, which tells the remedy."""
        name = self.resolve_topic_name(topic)
        if not self.wait(lambda: self.count_publishers(name) > 0, DISCOVERY_TIMEOUT_S):
            raise OperatorError(f"nobody publishes {name}: {remedy}")

    def rest(self, duration_s: float) -> None:
        """Let time of the robot pass, while everything is checked to be alive."""
        end = self.robot_time_s + duration_s
        self.wait(lambda: self.robot_time_s >= end, 10.0 * duration_s + SILENCE_S)

    def wait_for_recorder(self, name: str, left_out: str = "") -> None:
        """Wait until a node subscribes to all visible topics of this namespace that are published.

        ``left_out`` matches those that it is not to record. What is published before that is not in its recording.
        Raises `OperatorError` with a topic that it does not subscribe to in time.
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
        """How many runs the driver has begun for somebody else, as heard by an operator who saw it start."""
        return self._runs - self._own_runs

    @property
    def _runs(self) -> int:
        heard = self._heard.get(GaitState)
        return 0 if heard is None else int(heard.run)

    # --- what a person does --------------------------------------------------------------------

    def state(self) -> RobotState:
        """What is heard of the robot. Raises `OperatorError` if there is no driver."""
        for kind, topic in _TELEMETRY.items():
            if kind not in self._watched:
                self._watched.add(kind)
                self.create_subscription(kind, topic, self._hear, 10)
        self.wait_for_driver(DISCOVERY_TIMEOUT_S)
        self.wait(lambda: _TELEMETRY.keys() <= self._heard.keys(), TELEMETRY_S)
        return _state_of(self._state(DRIVER).label, self._heard)

    def activate(self) -> str:
        """Configure and activate the driver; returns what was done. Raises `OperatorError` if it does not get there."""
        asked = 0
        while (state := self._state(DRIVER)).id != State.PRIMARY_STATE_ACTIVE:
            if state.id not in _NEXT or asked == ATTEMPTS:
                raise OperatorError(f"{DRIVER} stays {state.label}: {self._reason()}")
            asked += 1
            self._errors.clear()
            self._change(DRIVER, _NEXT[state.id])
        return "the driver is active, its torque is on"

    def configure(self) -> None:
        """Configure a driver that is not yet; raises `OperatorError` if it cannot be."""
        if self._state(DRIVER).id == State.PRIMARY_STATE_UNCONFIGURED:
            self._errors.clear()
            if not self._change(DRIVER, Transition.TRANSITION_CONFIGURE):
                raise OperatorError(f"{DRIVER} cannot be configured: {self._reason()}")

    def deactivate(self) -> str:
        """Have a driver that is active come to rest and turn its torque off; returns what was done.

        Raises `OperatorError` if it stays active.
        """
        if self._state(DRIVER).id == State.PRIMARY_STATE_ACTIVE:
            self._errors.clear()
            if not self._change(DRIVER, Transition.TRANSITION_DEACTIVATE):
                raise OperatorError(f"{DRIVER} does not deactivate: {self._reason()}")
        return "the robot is at rest, its torque is off"

    def home(self) -> str:
        """Take the present cable length as the initial one; returns what was done. Raises `OperatorError`."""
        self.configure()
        return self._trigger("home")

    def reboot(self) -> str:
        """Restart the servos with a hardware error; returns what was done. Raises `OperatorError`."""
        return self._trigger("reboot")

    def stop(self) -> str:
        """Hold the robot where it is, at once; returns what was done. Raises `OperatorError`."""
        return self._trigger("stop")

    def prepare_stop(self) -> None:
        """Have the service that stops discovered before it is needed."""
        self._client(Trigger, "stop")

    def emergency_stop(self, on: bool) -> None:  # noqa: FBT001 (the topic's own value)
        """Hold at once and refuse every start, or permit starts again; waits until the driver says so.

        Raises `OperatorError` if it does not.
        """

        def follows() -> bool:
            self._emergency.publish(Bool(data=on))
            heard = self._heard.get(GaitState)
            return heard is not None and heard.emergency_stop == on

        if not self.wait(follows, CALL_TIMEOUT_S):
            raise OperatorError("the driver does not follow the topic emergency_stop")

    def inject_fault(self, name: str, **details: float) -> str:
        """Rehearse a fault on the virtual robot; returns what will happen. Raises `OperatorError`.

        ``details`` are the fields of InjectFault: target, delay, duration, count, value.
        """
        fault = InjectFault.Request(name=name, **details)
        response = self._call(InjectFault, "inject_fault", fault)
        if not response.success:
            raise OperatorError(response.message)
        return str(response.message)

    def request_gait(
        self,
        request: GaitRequest,
        progress: Callable[[str], None],
        direction: int = FORWARD,
        initial_length: float = 0.0,
    ) -> Prediction:
        """Ask the optimizer for a gait, again until it has a front.

        ``initial_length`` in m is that of the robot as it rests (`RobotState` has it), 0 that of the optimizer's
        parameters. ``progress`` gets the reason why there is no gait yet. Raises `UnreachableError`, and
        `OperatorError` with the last reason when there is none in time.
        """
        message = RequestGait.Request(
            objective=int(request.objective), direction=direction, initial_length=initial_length
        )
        if request.objective is Objective.MIN_POWER_AT_SPEED:
            message.speed = request.value
        elif request.objective is Objective.MAX_SPEED_AT_POWER:
            message.power = request.value
        deadline = time.monotonic() + OPTIMIZER_TIMEOUT_S
        while True:
            response = self._call_twice(RequestGait, "request_gait", message)
            if response.success:
                prediction = response.prediction
                return value_of(Prediction, prediction.gait, prediction)
            if response.status == RequestGait.Response.UNREACHABLE:
                raise UnreachableError(response.message)
            waits = response.status == RequestGait.Response.COMPUTING
            if not waits or time.monotonic() > deadline:
                raise OperatorError(f"the optimizer has no gait: {response.message}")
            progress(response.message)
            self.wait(lambda: False, REQUEST_PERIOD_S)

    def begin(self, order: Order, wanted: Callable[[], bool] = lambda: True) -> GaitRun:
        """Have a gait begun; whoever gets it closes it.

        The robot comes to rest when this operator is not heard any more, or ``wanted`` says no: it is asked four
        times a second. Raises `OperatorError` if there is nobody who could run it.
        """
        return self._sent(GaitRun(self, self._heartbeat, order, wanted))

    def search(
        self, order: ScanOrder | FrontOrder, on_end: Callable[[SearchResult], None]
    ) -> SearchGoal:
        """Have the optimizer begin a scan or an optimisation; whoever gets it closes it.

        It goes on while anything else is done. Raises `OperatorError` if there is no optimizer.
        """
        return self._sent(SearchGoal(self, order, on_end))

    def take_parameters(self, node: str, parameter_file: str) -> None:
        """Have a node take another parameter file, empty for the paper's values.

        Raises `OperatorError` if it refuses.
        """
        value = ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=parameter_file)
        request = SetParameters.Request(parameters=[Parameter(name="parameter_file", value=value)])
        answer = self._call_twice(SetParameters, f"{node}/set_parameters", request).results[0]
        if not answer.successful:
            raise OperatorError(f"{node} does not take {parameter_file}: {answer.reason}")

    def follow(
        self, run: GaitRun, progress: Progress, until: Callable[[], bool] = lambda: False
    ) -> bool:
        """Wait for a run's end, or until something else is so; whether the run has ended.

        ``progress`` gets each new word of it. Raises `OperatorError` when nothing is heard any more: a virtual
        robot's time may pass more slowly than this computer's, but as long as it goes on, all is well.
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
        """Run a gait to its end; raises `OperatorError`, `GaitFailedError` if it was begun and failed."""
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
        """A goal that has arrived; it is closed where it does not."""
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
        """The driver's own word on what has just failed, or where it is to be found."""
        self.wait(lambda: bool(self._errors), REASON_S)
        return self._errors[-1] if self._errors else "its log says why"

    def _state(self, node: str) -> State:
        answer = self._call_twice(GetState, f"{node}/get_state", GetState.Request())
        return answer.current_state

    def _change(self, node: str, transition: int) -> bool:
        request = ChangeState.Request(transition=Transition(id=transition))
        response = self._call(ChangeState, f"{node}/change_state", request)
        return bool(response.success)

    def _call_twice(self, kind: Any, name: str, request: Any) -> Any:
        """Call what may be called again: on a busy computer an answer can get lost with its discovery."""
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
        if name not in self._named_clients:  # one for good: a new one would be discovered anew
            self._named_clients[name] = self.create_client(kind, name)
        return self._named_clients[name]

    def _result(self, future: Future, name: str, timeout_s: float) -> Any:
        if not self.wait(future.done, timeout_s):
            raise _NoAnswerError(f"no answer from {name} within {timeout_s:g} s")
        return future.result()

    def wait(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        """Spin until a condition holds; false if it does not within a time (s)."""
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
