# SPDX-License-Identifier: Apache-2.0
"""Start, observe and call real nodes in integration tests."""

import contextlib
import time
from collections.abc import Callable
from typing import Any

import rclpy
from rcl_interfaces.srv import ListParameters
from rclpy.action import ActionClient, ActionServer
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import NodeNameNonExistentError
from rclpy.qos import QoSProfile
from rclpy.task import Future

from worm_msgs.goal_rejections import REJECTIONS_QOS, rejections_topic
from worm_msgs.msg import GoalRejection
from worm_msgs.qos import LATCHED as LATCHED
from worm_optimizer.operation.processes import Process, ProcessGroup, executable_command

NAMESPACE = "/worm"
TIMEOUT_S = 100.0  # long, as only a failing test waits so long
RETRY_S = 1.0


def ros_arguments(namespace: str = NAMESPACE, **parameters: object) -> list[str]:
    """Return the arguments of an executable in a namespace, with ROS parameters."""
    values = (word for key, value in parameters.items() for word in ("-p", f"{key}:={value}"))
    return ["--ros-args", "-r", f"__ns:={namespace}", *values]


class Processes(ProcessGroup):
    """The processes of one test."""

    def start_executable(
        self, package: str, executable: str, *arguments: str, name: str | None = None
    ) -> Process:
        """Start install/PACKAGE/lib/PACKAGE/EXECUTABLE."""
        return self.start(
            name or executable, [*executable_command(package, executable), *arguments]
        )

    def start_node(
        self, package: str, executable: str, *arguments: str, **parameters: object
    ) -> Process:
        """Start an executable in the worm's namespace, with ROS parameters."""
        return self.start_executable(package, executable, *arguments, *ros_arguments(**parameters))

    def operate(self, *arguments: str) -> Process:
        """Start `operate`, which waits patiently for a driver."""
        name, patience = f"operate_{len(self.processes)}", ("--timeout", f"{TIMEOUT_S:g}")
        return self.start_executable("worm_optimizer", "operate", *arguments, *patience, name=name)


class Probe:
    """A node in the worm's namespace whose every wait has a deadline."""

    def __init__(self, domain: int) -> None:
        self._context = rclpy.Context()
        self._context.init(domain_id=domain)
        self.node = rclpy.create_node("probe", context=self._context, namespace=NAMESPACE)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)

    def close(self) -> None:
        """End the node and its context.

        `destroy_node` leaves action servers alive until the garbage collector finds them. A later test in the same
        domain would count them as drivers.
        """
        self._executor.shutdown()
        for waitable in list(self.node.waitables):
            if isinstance(waitable, ActionServer):
                waitable.destroy()
        self.node.destroy_node()
        self._context.try_shutdown()

    def wait_for(
        self, condition: Callable[[], Any], what: str, timeout_s: float = TIMEOUT_S
    ) -> Any:
        """Spin until the condition is true and return its value; fail at the deadline."""
        deadline = time.monotonic() + timeout_s
        while True:
            value = condition()
            if value:
                return value
            assert time.monotonic() < deadline, f"no {what} within {timeout_s:g} s"
            self._executor.spin_once(timeout_sec=0.05)

    def spin_once(self, timeout_s: float) -> None:
        """Process the messages that arrive within a time."""
        self._executor.spin_once(timeout_sec=timeout_s)

    def collect(self, kind: type, topic: str, qos: QoSProfile | int = 1000) -> list[Any]:
        """Subscribe and return a list to which each message is appended."""
        messages: list[Any] = []
        self.node.create_subscription(kind, topic, messages.append, qos)
        return messages

    def result(self, future: Future, what: str, timeout_s: float = TIMEOUT_S) -> Any:
        """Spin until a future is done and return its result."""
        self.wait_for(future.done, what, timeout_s)
        return future.result()

    def call(self, kind: type, name: str, request: Any, timeout_s: float = TIMEOUT_S) -> Any:
        """Call a service when it is available and return its response."""
        client = self.node.create_client(kind, name)
        try:
            self.meet(name, timeout_s)
            self.wait_for(client.service_is_ready, f"service {name}", timeout_s)
            return self.result(client.call_async(request), f"response of {name}", timeout_s)
        finally:
            self.node.destroy_client(client)

    def meet(self, service: str, timeout_s: float = TIMEOUT_S) -> None:
        """Wait until the server of this service has discovered all clients that exist.

        Earlier responses get lost (the middleware logs a warning). The server discovers clients in the order of their
        creation, so the last one is a client that requests parameters, repeatedly if necessary.
        """
        name = self.node.resolve_service_name(service)
        services = self.wait_for(lambda: self._services_with(name), f"service {name}", timeout_s)
        server = next(node for node, offered in services.items() if name in offered)
        client = self.node.create_client(ListParameters, f"{server}/list_parameters")
        futures: list[Future] = []

        def answered() -> bool:
            if time.monotonic() > started + RETRY_S * len(futures):
                futures.append(client.call_async(ListParameters.Request()))
            return any(future.done() for future in futures)

        try:
            self.wait_for(client.service_is_ready, f"parameters of {server}", timeout_s)
            started = time.monotonic()
            self.wait_for(answered, f"word of {server}", timeout_s)
        finally:
            self.node.destroy_client(client)

    def _services_with(self, service: str) -> dict[str, set[str]]:
        """Return the services of each node, or nothing before one of them offers this service."""
        services = {}
        for name, namespace in self.node.get_node_names_and_namespaces():
            with contextlib.suppress(NodeNameNonExistentError):  # the node has just ended
                offered = self.node.get_service_names_and_types_by_node(name, namespace)
                services[f"{namespace.rstrip('/')}/{name}"] = {known for known, _ in offered}
        return services if any(service in offered for offered in services.values()) else {}

    def send_goal(
        self,
        kind: type,
        name: str,
        goal: Any,
        feedback: Callable[[Any], None] | None = None,
        timeout_s: float = TIMEOUT_S,
    ) -> Any:
        """Send a goal when the action server is available and return the goal handle."""
        client = ActionClient(self.node, kind, name)
        self.meet(f"{name}/_action/send_goal", timeout_s)
        self.wait_for(client.server_is_ready, f"action {name}", timeout_s)
        sent = client.send_goal_async(goal, feedback_callback=feedback)
        return self.result(sent, f"answer of {name}", timeout_s)

    def rejection(self, goal: Any, action: str = "run_gait") -> str:
        """Return why a goal of an action was rejected; fail if it was accepted."""
        assert not goal.accepted
        rejections = self.collect(GoalRejection, rejections_topic(action), REJECTIONS_QOS)
        own = bytes(goal.goal_id.uuid)

        def reason() -> str | None:
            return next((r.reason for r in rejections if bytes(r.goal) == own), None)

        return str(self.wait_for(reason, "reason of the rejection"))
