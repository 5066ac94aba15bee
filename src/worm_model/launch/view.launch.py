# SPDX-License-Identifier: Apache-2.0
"""Launch file for RViz with a robot and its twin: ros2 launch worm_model view.launch.py namespace:=worm.

robot_state_publisher publishes the frames of urdf/worm.urdf: those of the modules from the joint states of the twin,
those of spool and fins from the joint states of the driver. The pipe is fixed in odom, the frame of the twin's
odometry. Frames are published on the topics tf and tf_static of the robot's namespace, because each robot has its own
pipe.
"""

from __future__ import annotations

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchContext, LaunchDescription, LaunchDescriptionEntity
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

SHARE = Path(get_package_share_directory("worm_model"))
_TF = [("/tf", "tf"), ("/tf_static", "tf_static")]


def generate_launch_description() -> LaunchDescription:
    """Declare the arguments and start the nodes that they select."""
    return LaunchDescription(
        [
            DeclareLaunchArgument("namespace", default_value="worm", description="of the robot"),
            DeclareLaunchArgument(
                "rviz",
                default_value="true",
                choices=["true", "false"],
                description="start RViz, too",
            ),
            OpaqueFunction(function=_start),
        ]
    )


def _start(context: LaunchContext) -> list[LaunchDescriptionEntity]:
    def value(name: str) -> str:
        return LaunchConfiguration(name).perform(context)

    namespace = value("namespace").strip("/")
    robot = (SHARE / "urdf" / "worm.urdf").read_text(encoding="utf-8")
    nodes = [
        Node(
            package="tf2_ros",
            executable="static_transform_publisher",
            name="pipe_transform",
            namespace=namespace,
            arguments=["--frame-id", "odom", "--child-frame-id", "pipe"],
            remappings=_TF,
        ),
        _frames(namespace, robot, "twin_state_publisher", "twin/joint_states"),
        _frames(namespace, robot, "servo_state_publisher", "joint_states"),
    ]
    if value("rviz") == "true":
        nodes.append(
            Node(
                package="rviz2",
                executable="rviz2",
                namespace=namespace,
                arguments=["-d", str(SHARE / "rviz" / "worm.rviz")],
                remappings=[*_TF, ("/worm/twin/markers", "twin/markers")],
            )
        )
    return nodes


def _frames(namespace: str, robot: str, name: str, topic: str) -> Node:
    """Return the publisher of the frames of the joints on a topic."""
    return Node(
        package="robot_state_publisher",
        executable="robot_state_publisher",
        name=name,
        namespace=namespace,
        parameters=[{"robot_description": ParameterValue(robot, value_type=str)}],  # not YAML
        remappings=[*_TF, ("joint_states", topic)],
    )
