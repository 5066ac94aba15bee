# SPDX-License-Identifier: Apache-2.0
"""The frames: urdf/worm.urdf against the twin's messages and its scene."""

import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest

from worm_model.twin import scene

pytest.importorskip("worm_msgs.msg", reason="no ROS is installed")

from worm_driver.nodes import position_publisher, virtual_camera_node
from worm_model.nodes import twin_messages

URDF = Path(__file__).resolve().parents[3] / "src" / "worm_model" / "urdf" / "worm.urdf"


@pytest.fixture
def robot() -> ElementTree.Element:
    return ElementTree.parse(URDF).getroot()


def test_the_tree_goes_from_the_pipe_over_the_rear_to_the_front_module(robot):
    links = {
        joint.find("parent").get("link"): joint.find("child").get("link")
        for joint in robot.iter("joint")
    }
    assert links == {scene.FRAME: "rear_module", "rear_module": "front_module"}
    assert [link.get("name") for link in robot.iter("link")] == [
        scene.FRAME,
        "rear_module",
        "front_module",
    ]


def test_both_joints_run_forward_along_the_pipe_and_are_those_that_the_twin_publishes(robot):
    joints = list(robot.iter("joint"))
    assert tuple(joint.get("name") for joint in joints) == twin_messages.JOINTS
    assert {joint.get("type") for joint in joints} == {"prismatic"}
    assert {joint.find("axis").get("xyz") for joint in joints} == {"1 0 0"}


def test_the_modules_look_as_in_the_scene(robot):
    boxes = [box.get("size") for box in robot.iter("box")]
    assert [tuple(map(float, size.split())) for size in boxes] == [scene.MODULE] * 2
    colour = next(robot.iter("color")).get("rgba")
    assert tuple(map(float, colour.split())) == scene.ROBOT_COLOUR


def test_what_is_published_has_a_place_in_the_tree():
    """Positions in the pipe, images in the optical frame that the launch file hangs below the camera's."""
    assert position_publisher.FRAME == scene.FRAME
    launch = (URDF.parents[1] / "launch" / "view.launch.py").read_text()
    assert f'"camera", "{virtual_camera_node.FRAME}"' in launch
