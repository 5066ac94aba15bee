# SPDX-License-Identifier: Apache-2.0
"""Starts the nodes of config/system.yaml: ros2 launch worm_optimizer worm.launch.py mode:=virtual.

Every setting of system.yaml is a launch argument.
"""

from __future__ import annotations

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchContext, LaunchDescription, LaunchDescriptionEntity
from launch.actions import (
    DeclareLaunchArgument,
    OpaqueFunction,
    RegisterEventHandler,
    Shutdown,
)
from launch.event_handlers import OnProcessIO
from launch.events.process import ProcessIO
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import LifecycleNode, LifecycleTransition, Node
from launch_ros.parameter_descriptions import ParameterValue
from lifecycle_msgs.msg import Transition

from worm_optimizer.operation.system import MODES, NodeDescription, SystemFile, load_system_file

SYSTEM_FILE = Path(get_package_share_directory("worm_optimizer"), "config", "system.yaml")


def generate_launch_description() -> LaunchDescription:
    """Declare the mode and the settings of system.yaml, then start the nodes of the mode."""
    content = load_system_file(SYSTEM_FILE)
    arguments = [DeclareLaunchArgument("mode", default_value="virtual", choices=list(MODES))]
    arguments += [
        DeclareLaunchArgument(name, default_value=row.default, description=row.description)
        for name, row in content.settings.items()
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=_start, args=[content])])


def _start(context: LaunchContext, content: SystemFile) -> list[LaunchDescriptionEntity]:
    settings = {name: LaunchConfiguration(name).perform(context) for name in content.settings}
    mode = LaunchConfiguration("mode").perform(context)
    system = content.system(mode, **settings)
    return _start_in_order(system.nodes, system.namespace)


def _start_in_order(
    nodes: tuple[NodeDescription, ...], namespace: str
) -> list[LaunchDescriptionEntity]:
    """Start nodes up to the first that others wait for, and the others once it is ready."""
    actions: list[LaunchDescriptionEntity] = []
    for index, description in enumerate(nodes):
        node = _node(description, namespace)
        actions.append(node)
        if description.lifecycle:
            actions.append(_activation(f"/{namespace}/{description.name}"))
        if description.ready:
            rest = _start_in_order(nodes[index + 1 :], namespace)
            return [_when_ready(node, description.ready, rest), *actions]
    return actions


def _node(description: NodeDescription, namespace: str) -> Node:
    kind = LifecycleNode if description.lifecycle else Node
    # a typed value, or launch would take the text "1" for a number
    parameters = {
        name: ParameterValue(value, value_type=type(value)) if isinstance(value, str) else value
        for name, value in description.parameters.items()
    }
    return kind(
        package=description.package,
        executable=description.executable,
        name=description.name,
        namespace=namespace,
        arguments=list(description.arguments),
        parameters=[parameters],
        remappings=list(description.remappings.items()),
        output="screen",
        on_exit=OpaqueFunction(function=_end_all, args=[description.name]),
    )


def _end_all(context: LaunchContext, name: str) -> list[LaunchDescriptionEntity]:
    """End the others when one ends; but not once more while all end already."""
    return [] if context.is_shutdown else [Shutdown(reason=f"{name} has ended")]


def _activation(full_name: str) -> LifecycleTransition:
    """Configure and activate a node."""
    return LifecycleTransition(
        lifecycle_node_names=[full_name],
        transition_ids=[Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE],
    )


def _when_ready(
    node: Node, ready: str, actions: list[LaunchDescriptionEntity]
) -> RegisterEventHandler:
    waiting = [actions]

    def on_output(event: ProcessIO) -> list[LaunchDescriptionEntity]:
        lines = event.text.decode(errors="replace").splitlines()
        if waiting and any(ready in line for line in lines):
            return waiting.pop()
        return []

    return RegisterEventHandler(
        OnProcessIO(target_action=node, on_stdout=on_output, on_stderr=on_output)
    )
