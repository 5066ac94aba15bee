# SPDX-License-Identifier: Apache-2.0
"""The frames: urdf/worm.urdf, compared with the twin's messages and its scene."""

import math
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest
import yaml

from worm_driver.nodes import driver_messages
from worm_model.nodes import twin_messages
from worm_model.parameters import PAPER
from worm_model.twin import scene

SOURCES = Path(__file__).resolve().parents[3] / "src"
DRIVER_FILE = SOURCES / "worm_driver" / "config" / "driver.yaml"


ROBOT = ElementTree.parse(SOURCES / "worm_model" / "urdf" / "worm.urdf").getroot()
PLACES = ["rear_position", "body_length"]
SERVOS = ["cable_1", "fin_11", "fin_12"]


def joints() -> dict[str, ElementTree.Element]:
    return {joint.get("name"): joint for joint in ROBOT.iter("joint")}


def numbers(text: str) -> list[float]:
    return [float(part) for part in text.split()]


def test_the_tree_goes_from_the_pipe_over_the_rear_to_the_front_module():
    tree = {
        name: (joint.find("parent").get("link"), joint.find("child").get("link"))
        for name, joint in joints().items()
    }
    assert tree["rear_position"] == (scene.FRAME, "rear_module")
    assert tree["body_length"] == ("rear_module", "front_module")
    children = [child for _, child in tree.values()]
    assert sorted([scene.FRAME, *children]) == sorted(
        link.get("name") for link in ROBOT.iter("link")
    )
    assert len(set(children)) == len(children)


def test_the_joints_are_those_that_are_published():
    """Both the twin and a driver with the servos of driver.yaml publish them."""
    driver = yaml.safe_load(DRIVER_FILE.read_text())["/**/driver"]["ros__parameters"]
    cables = [f"cable_{number}" for number in driver["cable_servos"]["ids"]]
    fins = [f"fin_{number}" for number in driver["fin_servos"]["ids"]]
    assert list(twin_messages.JOINTS) == PLACES
    assert [*cables, *fins] == SERVOS
    assert sorted(joints()) == sorted([*PLACES, *SERVOS])


def test_the_fins_trail_in_the_direction_of_the_gait():
    """A fin points along z of its link; turned by the driver's angle, its tip is behind its root and at the wall."""
    driver = yaml.safe_load(DRIVER_FILE.read_text())["/**/driver"]["ros__parameters"]
    for name in ("fin_11", "fin_12"):
        (_, y, _) = numbers(joints()[name].find("axis").get("xyz"))
        for key, forward in (("forward_angle_rad", 1), ("reverse_angle_rad", -1)):
            for angle in driver["fin_servos"][key]:
                tip_x, tip_z = math.sin(y * angle), math.cos(y * angle)
                assert tip_x * forward < -0.5
                assert tip_z < -0.5


def test_every_link_that_moves_has_mass_inertia_and_a_collision():
    moving = {joint.find("child").get("link") for joint in ROBOT.iter("joint")}
    for link in ROBOT.iter("link"):
        if link.get("name") not in moving:
            continue
        assert float(link.find("inertial/mass").get("value")) > 0.0
        tensor = link.find("inertial/inertia").attrib
        a, b, c = sorted(float(tensor[key]) for key in ("ixx", "iyy", "izz"))
        # rounded; the file contains no other body
        assert 0.0 < a <= b <= c <= (a + b) * (1.0 + 1e-3)
        geometries = [link.find(f"{kind}/geometry")[0].attrib for kind in ("visual", "collision")]
        assert geometries[0] == geometries[1]


def test_each_module_has_the_mass_of_the_paper():
    parts = {
        "rear_module": ("rear_module", "cable_1_spool", "fin_11_fins"),
        "front_module": ("front_module", "fin_12_fins"),
    }
    mass = {
        link.get("name"): float(link.find("inertial/mass").get("value"))
        for link in ROBOT.iter("link")
        if link.find("inertial") is not None
    }
    assert sum(mass[name] for name in parts["rear_module"]) == pytest.approx(PAPER.rear_mass)
    assert sum(mass[name] for name in parts["front_module"]) == pytest.approx(PAPER.front_mass)


def test_positions_are_published_in_the_frame_of_the_pipe():
    assert driver_messages.FRAME == scene.FRAME
