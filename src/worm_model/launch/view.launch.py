# SPDX-License-Identifier: Apache-2.0
"""Launch file for RViz with a robot and its twin: ros2 launch worm_model view.launch.py namespace:=worm.

robot_state_publisher publishes the frames of urdf/worm.urdf: those of the modules from the joint states of the twin,
those of spool and fins from the joint states of the driver. The pipe is fixed in odom, the frame of the twin's
odometry. The argument camera:= adds the frames camera and, for its images, camera_optical_frame. Frames are published
on the topics tf and tf_static of the robot's namespace, because each robot has its own pipe.
"""

from __future__ import annotations

import math
from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchContext, LaunchDescription, LaunchDescriptionEntity
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

SHARE = Path(get_package_share_directory("worm_model"))
_TF = [("/tf", "tf"), ("/tf_static", "tf_static")]
_POSE = ("--x", "--y", "--z", "--yaw", "--pitch", "--roll")


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
            DeclareLaunchArgument(
                "camera",
                default_value="",
                description="pose of the camera in the pipe's frame, 'x y z yaw pitch roll' in m and rad; empty: "
                "no camera frames",
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
        _fixed(namespace, "odom", "pipe", ["0"] * len(_POSE)),
        _frames(namespace, robot, "twin_state_publisher", "twin/joint_states"),
        _frames(namespace, robot, "servo_state_publisher", "joint_states"),
    ]
    if value("camera"):
        nodes += _camera(namespace, value("camera"))
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


def _camera(namespace: str, pose: str) -> list[Node]:
    """Return publishers of the camera frame (x in viewing direction) and the optical frame (REP 103: z there)."""
    values = pose.split()
    if len(values) != len(_POSE):
        raise ValueError(
            f"camera:='{pose}': expected six numbers, x y z yaw pitch roll in m and rad"
        )
    right = f"{-math.pi / 2}"
    return [
        _fixed(namespace, "pipe", "camera", values),
        _fixed(namespace, "camera", "camera_optical_frame", ["0", "0", "0", right, "0", right]),
    ]


def _fixed(namespace: str, parent: str, child: str, pose: list[str]) -> Node:
    words = [word for pair in zip(_POSE, pose, strict=True) for word in pair]
    return Node(
        package="tf2_ros",
        executable="static_transform_publisher",
        name=f"{child}_transform",
        namespace=namespace,
        arguments=[*words, "--frame-id", parent, "--child-frame-id", child],
        remappings=_TF,
    )
