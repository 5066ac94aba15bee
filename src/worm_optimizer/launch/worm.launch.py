# SPDX-License-Identifier: Apache-2.0
"""Launch file of the nodes in config/system.yaml: ros2 launch worm_optimizer worm.launch.py mode:=virtual.

Every setting of system.yaml is a launch argument. All nodes start at once; each waits for what it needs. Other launch
files can include this one. A namespace that such a file pushes with PushRosNamespace is then a prefix of ``namespace``.
"""

import shutil
from functools import partial

from launch import LaunchContext, LaunchDescription, LaunchDescriptionEntity
from launch.actions import DeclareLaunchArgument, OpaqueFunction, Shutdown
from launch.events.process import ProcessExited
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.utilities import prefix_namespace

from worm_optimizer.operation.system import (
    MODES,
    RESTARTS,
    NodeDescription,
    SystemFile,
    installed_system_file,
)

# On SIGTERM, launch does not end its processes (ros2/launch#666). So Linux sends them SIGTERM when launch dies.
_SETPRIV = shutil.which("setpriv")  # util-linux
_PREFIX = [
    f"{_SETPRIV} --pdeathsig TERM " if _SETPRIV else "",
    LaunchConfiguration("launch-prefix", default=""),
]


def generate_launch_description() -> LaunchDescription:
    """Declare the mode and the settings of system.yaml, then start the nodes of the mode."""
    table = installed_system_file()
    declare = DeclareLaunchArgument
    return LaunchDescription(
        [
            declare("mode", default_value="virtual", choices=list(MODES)),
            declare("namespace", default_value=table.namespace, description="of all nodes"),
            declare("log_level", default_value="info", description="log level of all nodes"),
            *(
                declare(name, default_value=setting.default, description=setting.description)
                for name, setting in table.settings.items()
            ),
            OpaqueFunction(function=_nodes, args=[table]),
        ]
    )


def _nodes(context: LaunchContext, table: SystemFile) -> list[Node]:
    value = context.launch_configurations
    pushed = value.get("ros_namespace", "")
    namespace = prefix_namespace(pushed, value["namespace"]).strip("/")
    # Defaults are omitted, because `SystemFile.system` inserts the namespace into them.
    settings = {
        name: value[name] for name, row in table.settings.items() if value[name] != row.default
    }
    system = table.system(value["mode"], namespace, **settings)
    return [_node(node, namespace, value["log_level"]) for node in system.nodes]


def _node(description: NodeDescription, namespace: str, log_level: str) -> Node:
    # Without a type, launch would convert the text "1" to a number.
    parameters = {
        name: ParameterValue(value, value_type=str) if isinstance(value, str) else value
        for name, value in description.parameters.items()
    }
    return Node(
        package=description.package,
        executable=description.executable,
        exec_name=description.name,
        name=description.name,
        namespace=f"/{namespace}",
        arguments=list(description.arguments),
        ros_arguments=["--log-level", log_level],
        parameters=[parameters],
        remappings=list(description.remappings.items()),
        output="screen",
        prefix=_PREFIX,
        sigterm_timeout=str(description.end_timeout_s),
        on_exit=partial(_end_all, description) if description.required else None,
        respawn=not description.required,
        respawn_delay=2.0,
        respawn_max_retries=RESTARTS,
    )


def _end_all(
    description: NodeDescription, event: ProcessExited, _: LaunchContext
) -> list[LaunchDescriptionEntity]:
    """End all nodes, as a required one has ended. After a failure the exit status of launch is 1."""
    if event.returncode:
        raise RuntimeError(description.end_report(event.returncode))
    return [Shutdown(reason=f"{description.name} has ended")]
