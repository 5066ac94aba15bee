# SPDX-License-Identifier: Apache-2.0
"""Starts the nodes of config/system.yaml: ros2 launch worm_optimizer worm.launch.py mode:=virtual.

Every setting of system.yaml is a launch argument. Can be included in another launch file, also under
a PushRosNamespace, which then stands before ``namespace``.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchContext, LaunchDescription, LaunchDescriptionEntity
from launch.actions import (
    DeclareLaunchArgument,
    EmitEvent,
    LogInfo,
    OpaqueFunction,
    RegisterEventHandler,
    Shutdown,
)
from launch.event_handlers import OnProcessIO
from launch.events import matches_action
from launch.events.process import ProcessExited, ProcessIO
from launch.substitution import Substitution
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import LifecycleNode, Node
from launch_ros.event_handlers import OnStateTransition
from launch_ros.events.lifecycle import ChangeState, StateTransition
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.utilities import prefix_namespace
from lifecycle_msgs.msg import Transition

from worm_optimizer.operation.system import (
    MODES,
    RESTARTS,
    NodeDescription,
    SystemFile,
    SystemFileError,
    load_system_file,
)

# A virtual robot's time waits for whoever works with it: on a busy computer its seconds are longer.
VIRTUAL_SLOWNESS = 8.0
RESTART_DELAY_S = 2.0
GRACE_S = 5.0  # beyond the time in which a node says it is at rest; launch's own default
OWN_TIME = ("virtual_robot", "driver", "player")  # they make the time that the others go by
LEVELS = ("debug", "info", "warn", "error", "fatal")

# How a transition of launch's own ends when it succeeds, and what follows.
_SUCCESSES = {
    Transition.TRANSITION_CONFIGURE: ("inactive", Transition.TRANSITION_ACTIVATE),
    Transition.TRANSITION_ACTIVATE: ("active", None),
}
_UNDER_WAY = {
    Transition.TRANSITION_CONFIGURE: "configuring",
    Transition.TRANSITION_ACTIVATE: "activating",
}

SYSTEM_FILE = Path(get_package_share_directory("worm_optimizer"), "config", "system.yaml")


def generate_launch_description() -> LaunchDescription:
    """Declare the mode and the settings of system.yaml, then start the nodes of the mode."""
    content = load_system_file(SYSTEM_FILE)
    arguments = [
        DeclareLaunchArgument("mode", default_value="virtual", choices=list(MODES)),
        DeclareLaunchArgument(
            "namespace", default_value=content.namespace, description="of all nodes"
        ),
        DeclareLaunchArgument(
            "log_level", default_value="info", choices=list(LEVELS), description="of all nodes"
        ),
        DeclareLaunchArgument(
            "use_sim_time",
            default_value="",
            choices=["", "true", "false"],
            description="of the nodes that can go by /clock; empty: true in the mode replay alone",
        ),
    ]
    arguments += [
        DeclareLaunchArgument(name, default_value=row.default, description=row.description)
        for name, row in content.settings.items()
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=_start, args=[content])])


def _start(context: LaunchContext, content: SystemFile) -> list[LaunchDescriptionEntity]:
    def value(name: str) -> str:
        return LaunchConfiguration(name).perform(context)

    mode, namespace = value("mode"), _full_namespace(context, value("namespace"))
    # A default is filled in with the namespace by the system file, not here.
    settings = {
        name: value(name) for name, row in content.settings.items() if value(name) != row.default
    }
    system = content.system(mode, namespace, **settings)
    slowness = VIRTUAL_SLOWNESS if mode == "virtual" else 1.0
    sim_time = _sim_time(mode, value("use_sim_time"))
    common = _Common(namespace, slowness, value("log_level"), sim_time)
    return common.start_in_order(system.nodes)


def _full_namespace(context: LaunchContext, namespace: str) -> str:
    """The namespace under those that the including launch files have pushed, without the first slash."""
    pushed = context.launch_configurations.get("ros_namespace", "")
    return prefix_namespace(pushed, namespace).strip("/")


def _sim_time(mode: str, asked: str) -> dict[str, bool]:
    """The parameter that all nodes get; a robot's clock is the real one, also a virtual robot's."""
    if asked == "true" and mode != "replay":
        raise SystemFileError(
            f"use_sim_time:=true with mode:={mode}: a robot runs in real time; leave use_sim_time out"
        )
    return {"use_sim_time": asked == "true"} if asked else {}


class _Common:
    """What all nodes of one launch share."""

    def __init__(
        self, namespace: str, slowness: float, log_level: str, sim_time: dict[str, bool]
    ) -> None:
        self._namespace, self._log_level, self._sim_time = namespace, log_level, sim_time
        self._patience = _Patience(slowness)

    def start_in_order(self, nodes: tuple[NodeDescription, ...]) -> list[LaunchDescriptionEntity]:
        """Start nodes up to the first that others wait for, and the others once it is ready."""
        actions: list[LaunchDescriptionEntity] = []
        for index, description in enumerate(nodes):
            node = self._node(description)
            if description.at_rest_within:
                actions.append(_on_line(node, self._patience.reader(description.at_rest_within)))
            if description.lifecycle:
                actions += _Activation(node).entities()
            else:
                actions.append(node)
            if description.ready:
                rest = _Waiting(description.ready, self, nodes[index + 1 :])
                return [_on_line(node, rest), *actions]
        return actions

    def _node(self, description: NodeDescription) -> Node:
        kind = LifecycleNode if description.lifecycle else Node
        sim_time = {} if description.name in OWN_TIME else self._sim_time
        # a typed value, or launch would take the text "1" for a number
        parameters = {
            name: ParameterValue(value, value_type=type(value)) if isinstance(value, str) else value
            for name, value in {**description.parameters, **sim_time}.items()
        }
        return kind(
            package=description.package,
            executable=description.executable,
            exec_name=description.name,
            name=description.name,
            namespace=f"/{self._namespace}",
            arguments=list(description.arguments),
            ros_arguments=["--log-level", self._log_level],
            parameters=[parameters],
            remappings=list(description.remappings.items()),
            output="screen",
            prefix=_end_with_launch(),
            sigterm_timeout=[self._patience],
            on_exit=_AtEnd(description),
            respawn=not description.required,
            respawn_delay=RESTART_DELAY_S,
            respawn_max_retries=RESTARTS,
        )


def _end_with_launch() -> list[Substitution | str]:
    """What stands before a command so that its process is asked to end when launch dies.

    On SIGTERM, launch itself leaves its processes behind (ros2/launch#666): a gait would run on.
    """
    tool = shutil.which("setpriv")  # util-linux
    own = [f"{tool} --pdeathsig TERM "] if tool else []
    return [*own, LaunchConfiguration("launch-prefix", default="")]


class _Patience(Substitution):
    """The time (s) after which launch gets impatient with nodes that were asked to end.

    One for all: the virtual robot and the recorder stay for as long as the driver needs them.
    """

    def __init__(self, slowness: float) -> None:
        super().__init__()
        self._slowness = slowness
        self._rest_s = 0.0

    def reader(self, words: str) -> _LineReader:
        """Takes the time from the lines in which it stands behind some words, the last one holds."""
        pattern = re.compile(re.escape(words) + r" ([0-9.]+) s")

        def read(line: str) -> None:
            match = pattern.search(line)
            if match:
                self._rest_s = self._slowness * float(match[1])

        return _LineReader(read)

    def describe(self) -> str:
        """For launch's introspection."""
        return "Patience()"

    def perform(self, _: LaunchContext) -> str:
        """Launch asks when everything is to end."""
        return f"{self._rest_s + GRACE_S:g}"


class _AtEnd:
    """What follows when a node has ended: a required one ends all, another one is started again."""

    def __init__(self, description: NodeDescription) -> None:
        self._name = description.name
        self._required = description.required
        self._restarts = RESTARTS

    def __call__(
        self, event: ProcessExited, context: LaunchContext
    ) -> list[LaunchDescriptionEntity]:
        if context.is_shutdown:
            return []
        what = f"{self._name} has ended with exit status {event.returncode}"
        if not self._required:
            return [LogInfo(msg=f"{what}: {self._what_follows()}")]
        if event.returncode:
            raise RuntimeError(what)  # launch ends everything, and has exit status 1
        return [Shutdown(reason=f"{self._name} has ended")]

    def _what_follows(self) -> str:
        self._restarts -= 1
        if self._restarts < 0:
            return "the others run on without it"
        return f"it starts again in {RESTART_DELAY_S:g} s"


class _Activation:
    """Configures and activates a node after its start, once.

    A failure, and the first transition that somebody else asks for, hand the node over to its operator:
    torque comes only to who asks for it.
    """

    def __init__(self, node: LifecycleNode) -> None:
        self._node = node
        self._asked: int | None = None  # for the transition whose end is awaited
        self._ours = True

    def entities(self) -> list[LaunchDescriptionEntity]:
        """The node and all that it takes."""
        watch = OnStateTransition(
            target_lifecycle_node=self._node,
            entities=[OpaqueFunction(function=self._on_transition)],
        )
        start = OpaqueFunction(function=self._ask, args=[Transition.TRANSITION_CONFIGURE])
        return [RegisterEventHandler(watch), self._node, start]

    def _ask(self, context: LaunchContext, transition: int) -> list[LaunchDescriptionEntity]:
        if context.is_shutdown or not self._ours:
            return []
        self._asked = transition
        change = ChangeState(
            lifecycle_node_matcher=matches_action(self._node), transition_id=transition
        )
        return [EmitEvent(event=change)]

    def _on_transition(self, context: LaunchContext) -> list[LaunchDescriptionEntity]:
        event = context.locals.event
        if not self._ours or not isinstance(event, StateTransition):
            return []
        asked = self._asked
        if asked is None:  # by somebody else
            self._ours = False
            return []
        if event.goal_state == _UNDER_WAY[asked]:
            return []
        self._asked = None
        goal, following = _SUCCESSES[asked]
        if event.goal_state != goal:
            return self._failed(context)
        self._ours = following is not None
        return self._ask(context, following) if following is not None else []

    def _failed(self, context: LaunchContext) -> list[LaunchDescriptionEntity]:
        self._ours = False
        if context.is_shutdown:
            return []
        name = self._node.node_name
        return [
            LogInfo(
                msg=f"{name} is yours now: launch does not try again. Mend what it says above, then: "
                f"ros2 lifecycle set {name} configure, and ros2 lifecycle set {name} activate"
            )
        ]


class _LineReader:
    """Calls a function for each whole line of a node's output, in whichever pieces it comes."""

    def __init__(self, read: Callable[[str], list[LaunchDescriptionEntity] | None]) -> None:
        self._read = read
        self._rests: dict[bool, str] = {}  # by stream

    def __call__(self, event: ProcessIO) -> list[LaunchDescriptionEntity]:
        text = self._rests.get(event.from_stdout, "") + event.text.decode(errors="replace")
        *lines, self._rests[event.from_stdout] = text.split("\n")
        for line in lines:
            entities = self._read(line)
            if entities:
                return entities
        return []


class _Waiting(_LineReader):
    """Starts nodes at the first line with some words."""

    def __init__(self, words: str, common: _Common, nodes: tuple[NodeDescription, ...]) -> None:
        super().__init__(self._start)
        self._words, self._common, self._nodes = words, common, nodes

    def _start(self, line: str) -> list[LaunchDescriptionEntity]:
        if self._words not in line:
            return []
        nodes, self._nodes = self._nodes, ()
        return self._common.start_in_order(nodes)


def _on_line(node: Node, reader: _LineReader) -> RegisterEventHandler:
    return RegisterEventHandler(OnProcessIO(target_action=node, on_stdout=reader, on_stderr=reader))
