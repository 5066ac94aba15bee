# SPDX-License-Identifier: Apache-2.0
"""Launch file of the nodes in config/system.yaml: ros2 launch worm_optimizer worm.launch.py mode:=virtual.

Every setting of system.yaml is a launch argument. Other launch files can include this one. A namespace that such a file
pushes with PushRosNamespace is then a prefix of ``namespace``.

This file calls no service and publishes nothing. It starts no node in a namespace in which a node graph or a driver
runs. The driver configures and activates itself after it has verified that it is the only driver.
"""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Iterable
from pathlib import Path
from socket import socket

from ament_index_python.packages import get_package_share_directory
from launch import Event, LaunchContext, LaunchDescription, LaunchDescriptionEntity
from launch.actions import (
    DeclareLaunchArgument,
    LogInfo,
    OpaqueFunction,
    RegisterEventHandler,
    Shutdown,
)
from launch.event_handler import EventHandler
from launch.event_handlers import OnProcessStart
from launch.events.process import ProcessExited
from launch.substitution import Substitution
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.utilities import prefix_namespace

from worm_msgs.claim import ClaimedError, claim_graph, domain_of
from worm_msgs.readiness import Readiness
from worm_msgs.yaml_file import unknown_name
from worm_optimizer.operation.system import (
    MODES,
    RESTARTS,
    NodeDescription,
    SystemFile,
    SystemFileError,
    load_system_file,
)

RESTART_DELAY_S = 2.0  # time from the end of a node to its restart, s
OWN_TIME = ("virtual_robot", "driver", "player")  # nodes that never use /clock
LEVELS = ("debug", "info", "warn", "error", "fatal")
LAUNCH_ARGUMENTS = (  # arguments of launch itself, which every launch file accepts
    *("launch-prefix", "launch-prefix-filter", "emulate_tty"),
    *("sigterm_timeout", "sigkill_timeout", "ros_params", "ros_remaps", "ros_namespace"),
)

SYSTEM_FILE = Path(get_package_share_directory("worm_optimizer"), "config", "system.yaml")


def generate_launch_description() -> LaunchDescription:
    """Declare the mode and the settings of system.yaml, then start the nodes of the mode."""
    content = load_system_file(SYSTEM_FILE)
    arguments = [
        DeclareLaunchArgument("mode", default_value="virtual", choices=list(MODES)),
        DeclareLaunchArgument(
            "namespace", default_value=content.namespace, description="namespace of all nodes"
        ),
        DeclareLaunchArgument(
            "log_level",
            default_value="info",
            choices=list(LEVELS),
            description="log level of all nodes",
        ),
        DeclareLaunchArgument(
            "use_sim_time",
            default_value="",
            choices=["", "true", "false"],
            description="use_sim_time of the nodes that can use /clock, true only with mode:=replay; empty: the "
            "values in system.yaml",
        ),
    ]
    arguments += [
        DeclareLaunchArgument(name, default_value=row.default, description=row.description)
        for name, row in content.settings.items()
    ]
    check = OpaqueFunction(
        function=_reject_unknown, args=[[argument.name for argument in arguments]]
    )
    return LaunchDescription([check, *arguments, OpaqueFunction(function=_start, args=[content])])


def _reject_unknown(context: LaunchContext, known: list[str]) -> None:
    """Raise `SystemFileError` if an argument of the command line is unknown.

    If another launch file includes this one, all arguments are accepted, because some may belong to the other file.
    """
    if not any(Path(argument).name == Path(__file__).name for argument in sys.argv):
        return
    for argument in context.argv:
        name = argument.partition(":=")[0]
        if name not in (*known, *LAUNCH_ARGUMENTS):
            raise SystemFileError(unknown_name("launch argument", name, known))


def _start(context: LaunchContext, content: SystemFile) -> list[LaunchDescriptionEntity]:
    def value(name: str) -> str:
        return LaunchConfiguration(name).perform(context)

    mode, namespace = value("mode"), _full_namespace(context, value("namespace"))
    # Defaults are omitted, because `SystemFile.system` inserts the namespace into them.
    settings = {
        name: value(name) for name, row in content.settings.items() if value(name) != row.default
    }
    system = content.system(mode, namespace, **settings)
    sim_time = _sim_time(mode, value("use_sim_time"))
    try:
        claim = claim_graph(namespace, domain_of(os.environ))
    except ClaimedError as error:
        raise SystemFileError(str(error)) from None
    return _Graph(claim, namespace, value("log_level"), sim_time).start(system.nodes)


def _full_namespace(context: LaunchContext, namespace: str) -> str:
    """Return the namespace, with the namespaces pushed by including launch files as prefix, without the first slash."""
    pushed = context.launch_configurations.get("ros_namespace", "")
    return prefix_namespace(pushed, namespace).strip("/")


def _sim_time(mode: str, requested: str) -> dict[str, bool]:
    """Return the parameter use_sim_time if it is requested. Raise `SystemFileError` for true outside of a replay."""
    if requested == "true" and mode != "replay":
        raise SystemFileError(
            f"use_sim_time:=true with mode:={mode}: a robot runs in real time; remove use_sim_time"
        )
    return {"use_sim_time": requested == "true"} if requested else {}


class _Ready(Event):
    """Event: a node has reported readiness."""

    name = "worm.Ready"


class _Graph:
    """Nodes of one robot. The object holds the claim of the namespace, and exists as long as launch runs."""

    def __init__(
        self, claim: socket, namespace: str, log_level: str, sim_time: dict[str, bool]
    ) -> None:
        self._claim, self._namespace = claim, namespace
        self._log_level, self._sim_time = log_level, sim_time
        self._running: set[str] = set()
        self._ready: set[str] = set()
        self._restarts: dict[str, int] = {}
        self._failure = ""

    def start(self, nodes: Iterable[NodeDescription]) -> list[LaunchDescriptionEntity]:
        """Start nodes up to the first awaited one, and the following nodes when that one is ready."""
        entities: list[LaunchDescriptionEntity] = []
        waiting = list(nodes)
        while waiting:
            description = waiting.pop(0)
            if description.awaited:
                return entities + self._awaited(description, waiting)
            entities += self._node(description, {})
        return entities

    def _awaited(
        self, description: NodeDescription, following: list[NodeDescription]
    ) -> list[LaunchDescriptionEntity]:
        readiness, event = Readiness(), _Ready()

        def listen(context: LaunchContext) -> None:
            loop = context.asyncio_loop
            assert loop is not None  # while launch runs

            def on_report() -> None:
                if readiness():
                    loop.remove_reader(readiness.fileno())
                    readiness.close()
                    context.emit_event_sync(event)

            loop.add_reader(readiness.fileno(), on_report)

        def start_following(context: LaunchContext) -> list[LaunchDescriptionEntity]:
            self._ready.add(description.name)
            return [] if context.is_shutdown else self.start(following)

        handler = EventHandler(
            matcher=lambda other: other is event, entities=OpaqueFunction(function=start_following)
        )
        return [
            OpaqueFunction(function=listen),
            RegisterEventHandler(handler),
            *self._node(description, readiness.environment),
        ]

    def _node(
        self, description: NodeDescription, environment: dict[str, str]
    ) -> list[LaunchDescriptionEntity]:
        sim_time = {} if description.name in OWN_TIME else self._sim_time
        own = {"autostart": True, "stay_on_failure": True} if description.lifecycle else {}
        # Without a type, launch would convert the text "1" to a number.
        parameters = {
            name: ParameterValue(value, value_type=type(value)) if isinstance(value, str) else value
            for name, value in {**description.parameters, **sim_time, **own}.items()
        }

        def on_exit(event: ProcessExited, context: LaunchContext) -> list[LaunchDescriptionEntity]:
            return self._on_exit(description, event, context)

        node = Node(
            package=description.package,
            executable=description.executable,
            exec_name=description.name,
            name=description.name,
            namespace=f"/{self._namespace}",
            arguments=list(description.arguments),
            ros_arguments=["--log-level", self._log_level],
            parameters=[parameters],
            remappings=list(description.remappings.items()),
            additional_env=environment,
            output="screen",
            prefix=_end_with_launch(),
            sigterm_timeout=str(description.end_timeout_s),
            on_exit=on_exit,
            respawn=not description.required,
            respawn_delay=RESTART_DELAY_S,
            respawn_max_retries=RESTARTS,
        )

        def on_start(_: object, __: LaunchContext) -> None:
            self._running.add(description.name)

        return [
            RegisterEventHandler(OnProcessStart(target_action=node, on_start=on_start)),
            node,
        ]

    def _on_exit(
        self, description: NodeDescription, event: ProcessExited, context: LaunchContext
    ) -> list[LaunchDescriptionEntity]:
        """End all nodes if a required node has ended. Report the end of any other node.

        Launch restarts the other node up to `RESTARTS` times.

        A failure is raised only when all nodes have ended. Its message is then the last line of launch, and the exit
        status is 1.
        """
        name, status = description.name, event.returncode
        self._running.discard(name)
        was_ready = name in self._ready
        report = description.end_report(status, was_ready=was_ready)
        ends_all = description.required and not context.is_shutdown
        if status and (ends_all or (description.lifecycle and was_ready)):
            self._failure = self._failure or report
        if self._failure and not self._running:
            raise RuntimeError(self._failure)
        if context.is_shutdown:
            return []
        if description.required:
            return [Shutdown(reason=report)]
        return [LogInfo(msg=f"{report}: {self._what_follows(name)}")]

    def _what_follows(self, name: str) -> str:
        left = self._restarts[name] = self._restarts.get(name, RESTARTS) - 1
        if left < 0:
            return "the other nodes continue without it"
        return f"it starts again in {RESTART_DELAY_S:g} s"


def _end_with_launch() -> list[Substitution | str]:
    """Return a prefix of commands that makes Linux send SIGTERM to a process when launch dies.

    On SIGTERM, launch itself does not end its processes (ros2/launch#666), so that a gait would continue.
    """
    tool = shutil.which("setpriv")  # util-linux
    own = [f"{tool} --pdeathsig TERM "] if tool else []
    return [*own, LaunchConfiguration("launch-prefix", default="")]
