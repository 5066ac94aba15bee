# SPDX-License-Identifier: Apache-2.0
"""What an operator does with the robot, as blocking calls with deadlines; for the demo's process."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rclpy.action import ActionClient
from rclpy.client import Client
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.task import Future
from rosgraph_msgs.msg import Clock
from std_srvs.srv import Trigger

from worm_model import gait as model
from worm_msgs.action import RunGait
from worm_msgs.msg import Gait, GaitPrediction
from worm_msgs.srv import RequestGait
from worm_optimizer.robustness.prediction import Prediction

NODES_TIMEOUT_S = 120.0  # a twin whose kernel is not compiled yet does that first
DISCOVERY_TIMEOUT_S = 30.0
LEASE_S = 25.0  # DDS believes for 20 s that a participant lives which says nothing any more
CALL_TIMEOUT_S = 30.0
SILENCE_S = 60.0  # without a word of a gait that runs, after which it has failed
OPTIMIZER_TIMEOUT_S = 120.0  # it may still be searching its front
REQUEST_PERIOD_S = 1.0
ATTEMPTS = 2  # at transitions of a lifecycle node: from unconfigured to active
SPIN_S = 0.05
_NEXT = {
    State.PRIMARY_STATE_UNCONFIGURED: Transition.TRANSITION_CONFIGURE,
    State.PRIMARY_STATE_INACTIVE: Transition.TRANSITION_ACTIVATE,
}


class OperatorError(RuntimeError):
    """A node did not answer in time, or refused."""


class GaitFailedError(OperatorError):
    """A gait was begun, and not brought to its end."""


class _NoAnswerError(OperatorError):
    """Nothing came back in time."""


@contextmanager
def operator(namespace: str, check: Callable[[], None]) -> Iterator[OperatorNode]:
    """An operator's node with a ROS context of its own, in which signals stay Python's.

    Nothing of it is announced in the ROS graph afterwards, whatever happened.
    """
    context = rclpy.Context()
    context.init(args=[])
    try:
        node = OperatorNode(namespace, check, context)
        try:
            yield node
        finally:
            node.destroy_node()
    finally:
        context.try_shutdown()


class OperatorNode(Node):
    """Calls the services and actions of the driver and the optimizer in its own namespace.

    ``late_cycles`` is how many deadlines the driver says that it has missed since its start.
    ``check`` is called while waiting and may raise, such as when a node's process has died.
    """

    def __init__(self, namespace: str, check: Callable[[], None], context: rclpy.Context) -> None:
        super().__init__("operator", namespace=namespace, context=context)
        self._check = check
        self._named_clients: dict[str, Client] = {}
        self.late_cycles = 0
        self._simulated_s: float | None = None  # by /clock, where somebody publishes it
        self.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)
        self.create_subscription(Clock, "/clock", self._on_clock, 10)
        self._executor = SingleThreadedExecutor(context=context)
        self._executor.add_node(self)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == "driver: timing":
                values = {value.key: value.value for value in status.values}
                self.late_cycles = int(values.get("missed_deadlines", 0))

    def _on_clock(self, message: Clock) -> None:
        self._simulated_s = message.clock.sec + 1e-9 * message.clock.nanosec

    @property
    def robot_time_s(self) -> float:
        """The time by /clock (s) if somebody publishes it, else the computer's, monotonic."""
        return time.monotonic() if self._simulated_s is None else self._simulated_s

    def destroy_node(self) -> None:
        """End the node and what spins it."""
        self._executor.shutdown()
        super().destroy_node()

    def wait_for_nodes(self, names: Iterable[str]) -> None:
        """Wait until these nodes are there; raises `OperatorError` if one is not, or is there twice.

        Two nodes of one name in this ROS domain mean that another worm runs, and commands would reach
        both; those of a process that was killed go after a while.
        """
        expected = {*names, self.get_name()}
        self._wait(lambda: expected <= set(self._names()), NODES_TIMEOUT_S)
        missing = sorted(expected - set(self._names()))
        if missing:
            raise OperatorError(f"no node {missing[0]} within {NODES_TIMEOUT_S:g} s")
        if not self._wait(lambda: not self._repeated(expected), LEASE_S):
            raise self._another_worm(sorted(self._names()))

    def _repeated(self, names: set[str]) -> list[str]:
        found = self._names()
        return [name for name in names if found.count(name) > 1]

    def refuse_strangers(self, names: Iterable[str]) -> None:
        """Raise `OperatorError` if the namespace has other nodes than these: another worm runs.

        A node beside one of these carries its name and a purpose (driver_stop) and is no stranger. A process
        that was killed is announced for a while after its end, and is waited for.
        """
        expected = sorted({*names, self.get_name()})
        beside = tuple(f"{name}_" for name in expected)

        def found() -> list[str]:
            return sorted(n for n in self._names() if n in expected or not n.startswith(beside))

        if not self._wait(lambda: found() == expected, LEASE_S):
            raise self._another_worm(sorted(self._names()))

    def _another_worm(self, found: list[str]) -> OperatorError:
        return OperatorError(
            f"another worm runs in this ROS domain: the nodes of {self.get_namespace()} are "
            f"{', '.join(found)}; end it, or set ROS_DOMAIN_ID to another number for one of them"
        )

    def wait_for_publisher(self, topic: str, remedy: str) -> None:
        """Wait until somebody publishes a topic; raises `OperatorError`, which tells the remedy."""
        name = self.resolve_topic_name(topic)
        if not self._wait(lambda: self.count_publishers(name) > 0, DISCOVERY_TIMEOUT_S):
            raise OperatorError(f"nobody publishes {name}: {remedy}")

    def rest(self, duration_s: float) -> None:
        """Let time of the robot pass, while everything is checked to be alive."""
        end = self.robot_time_s + duration_s
        self._wait(lambda: self.robot_time_s >= end, 10.0 * duration_s + SILENCE_S)

    def wait_for_recorder(self, name: str) -> None:
        """Wait until a node subscribes to all visible topics of this namespace that are published.

        What is published before that is not in its recording. Raises `OperatorError` with a topic
        that it does not subscribe to in time.
        """
        if not self._wait(lambda: not self._unheard_topics(name), DISCOVERY_TIMEOUT_S):
            raise OperatorError(f"{name} does not subscribe to {self._unheard_topics(name)[0]}")

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

    def activate(self, node: str) -> None:
        """Configure and activate a lifecycle node; raises `OperatorError` if it does not get there."""
        attempts = 0
        while (state := self._state(node)).id != State.PRIMARY_STATE_ACTIVE:
            if state.id not in _NEXT or attempts == ATTEMPTS:
                raise OperatorError(f"{node} stays {state.label}: its log says why")
            attempts += 1
            self._change(node, _NEXT[state.id])

    def deactivate(self, node: str) -> None:
        """Deactivate a lifecycle node, which turns the torque of a driver off."""
        if not self._change(node, Transition.TRANSITION_DEACTIVATE):
            raise OperatorError(f"{node} does not deactivate: its log says why")

    def request_cruise(self, progress: Callable[[str], None]) -> Prediction:
        """Ask the optimizer for its most economical forward gait, again until it has a front.

        ``progress`` gets the reason why there is no gait yet. Raises `OperatorError` with the last
        reason when there is none in time.
        """
        request = RequestGait.Request(objective=RequestGait.Request.CRUISE, direction=Gait.FORWARD)
        deadline = time.monotonic() + OPTIMIZER_TIMEOUT_S
        while True:
            response = self._call_twice(RequestGait, "request_gait", request)
            if response.success:
                return _prediction_of(response.prediction)
            if time.monotonic() > deadline:
                raise OperatorError(f"the optimizer has no gait: {response.message}")
            progress(response.message)
            self._wait(lambda: False, REQUEST_PERIOD_S)

    def run_gait(self, gait: model.Gait, cycles: int, progress: Callable[[int], None]) -> None:
        """Run a gait to its end; raises `OperatorError` if it is refused, `GaitFailedError` if it fails.

        ``progress`` gets the number of cycles begun.
        """
        client = ActionClient(self, RunGait, "run_gait")
        try:
            self._run_goal(client, gait, cycles, progress)
        finally:
            client.destroy()  # else the node stays announced

    def _run_goal(
        self, client: ActionClient, gait: model.Gait, cycles: int, progress: Callable[[int], None]
    ) -> None:
        if not self._wait(client.server_is_ready, DISCOVERY_TIMEOUT_S):
            raise OperatorError("no action run_gait")
        goal = RunGait.Goal(cycles=cycles)
        goal.gait = Gait(
            stroke=gait.stroke,
            frequency=gait.frequency,
            direction=gait.direction,
            margin=gait.margin,
        )
        heard = [time.monotonic()]

        def hear(message: Any) -> None:
            heard[0] = time.monotonic()
            progress(message.feedback.cycle)

        sent = client.send_goal_async(goal, hear)
        handle = self._result(sent, "run_gait", CALL_TIMEOUT_S)
        if not handle.accepted:
            raise OperatorError("the driver refuses the gait: its log says why")
        ended = handle.get_result_async()
        # A virtual robot's time may pass more slowly than this computer's: as long as it goes on, all is well.
        while not ended.done() and time.monotonic() < heard[0] + SILENCE_S:
            self._wait(ended.done, 1.0)
        answer = self._result(ended, "run_gait", 0.0)
        if not answer.result.success:
            raise GaitFailedError(f"the gait failed: {answer.result.message}")

    def stop(self) -> None:
        """Stop the robot at once."""
        response = self._call_twice(Trigger, "stop", Trigger.Request())
        if not response.success:
            raise OperatorError(f"the driver did not stop: {response.message}")

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
        if name not in self._named_clients:  # one for good: a new one would be discovered anew
            self._named_clients[name] = self.create_client(kind, name)
        client = self._named_clients[name]
        if not self._wait(client.service_is_ready, DISCOVERY_TIMEOUT_S):
            raise OperatorError(f"no service {name}")
        return self._result(client.call_async(request), name, CALL_TIMEOUT_S)

    def _result(self, future: Future, name: str, timeout_s: float) -> Any:
        if not self._wait(future.done, timeout_s):
            raise _NoAnswerError(f"no answer from {name} within {timeout_s:g} s")
        return future.result()

    def _wait(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        deadline = time.monotonic() + timeout_s
        while not condition():
            if time.monotonic() > deadline:
                return False
            self._check()
            self._executor.spin_once(timeout_sec=SPIN_S)
        return True


def _prediction_of(message: GaitPrediction) -> Prediction:
    gait = message.gait
    values = {
        row.name: getattr(gait if hasattr(gait, row.name) else message, row.name)
        for row in dataclasses.fields(Prediction)
    }
    return Prediction(**values)
