# SPDX-License-Identifier: Apache-2.0
"""ROS parameter files: the same values as ROS reads, and the parameters of one driver."""

import math
from collections.abc import Iterator

import pytest
import rclpy
from rclpy.node import Node

from worm_msgs.driver_file import read_driver_file
from worm_msgs.ros_parameter_file import matches, read_sections
from worm_msgs.yaml_file import SettingsFileError

SCALARS = (
    *("3e-2", "-1E3", "5.", ".5", "+7", "0x1F", "-010", "08", "1_000", "12:30", "2027-02-30"),
    *("yes", "Off", "y", "yEs", "null", "~", "inf", "-.inf", ".NaN", "'0.5'", '"on"', "!metre 3"),
    *("99999999999999999999", "[yes, no]", "[1e-3, 2.5]", "\t4.5", "word # remark"),
)


@pytest.fixture(autouse=True)
def _domain(ros_domain) -> Iterator[None]:
    yield
    rclpy.try_shutdown()


@pytest.fixture
def file(tmp_path):
    def write(text: str):
        path = tmp_path / "robot.yaml"
        path.write_text(text)
        return path

    return write


def read_by_ros(path, name: str, namespace: str) -> dict[str, object]:
    rclpy.init(args=["x", "--ros-args", "--params-file", str(path)])
    node = Node(name, namespace=namespace)
    overrides = node._parameter_overrides
    node.destroy_node()
    rclpy.shutdown()
    values = {key: parameter.value for key, parameter in overrides.items()}
    return {k: list(v) if hasattr(v, "tolist") else v for k, v in values.items()}


def read_by_us(path, full_name: str) -> dict[str, object]:
    own = [values for pattern, values in read_sections(path) if matches(pattern, full_name)]
    return {key: value for values in own for key, value in values.items()}


def test_scalars_have_the_values_and_types_of_ros(file):
    rows = "\n".join(f"    p{k}: {text}" for k, text in enumerate(SCALARS))
    path = file(f"/**/driver:\n  ros__parameters:\n{rows}\n    deep: {{x.y: 1, z: 2}}\n")
    theirs, ours = read_by_ros(path, "driver", "/worm"), read_by_us(path, "/worm/driver")
    assert {k: (type(v), repr(v)) for k, v in ours.items()} == {
        k: (type(v), repr(v)) for k, v in theirs.items()
    }
    assert math.isnan(ours[f"p{SCALARS.index('.NaN')}"])


@pytest.mark.parametrize("form", ["{x}: {y}\n/**: {z}", "/**: {y}\n---\n{x}: {z}"])
def test_sections_apply_to_the_nodes_of_ros_in_the_order_of_ros(file, form):
    patterns = (
        *("/worm/driver", "worm/driver", "/**/driver", "/*/driver", "/worm/*", "/worm/**", "/**"),
        *("/*", "/*/*", "/driver", "/**/worm/driver", "/**/worm/*/driver", "/robot2/driver"),
    )
    content = {"y": "{ros__parameters: {a: 1, b: 2}}", "z": "{ros__parameters: {b: 3}}"}
    for pattern in patterns:
        path = file(form.format(x=f"'{pattern}'", **content))
        assert read_by_us(path, "/worm/driver") == read_by_ros(path, "driver", "/worm"), pattern


LIMIT = "{{ros__parameters: {{limits: {{max_stroke_m: {}}}}}}}"


@pytest.mark.parametrize(
    ("sections", "stroke"),
    [
        ([("/*", "{driver: %s}", 0.031), ("/**", "%s", 0.07)], 0.07),
        ([("/**", "%s", 0.07), ("/*", "{driver: %s}", 0.031)], 0.031),
        ([("/crawler/driver", "%s", 0.04), ("/crawler/twin", "%s", 0.05)], 0.04),
        ([("/crawler", "{driver: %s, twin: {}}", 0.04), ("/*", "%s", 0.05)], 0.04),
        ([("/crawler/**", "%s", 0.04)], 0.04),
        ([("/crawler/driver", "%s", 0.04), ("/crawler/driver/", "%s", 0.02)], 0.02),
        ([("driver", "%s", 0.06), ("/twin", "%s", 0.05)], 0.06),
    ],
)
def test_the_limits_are_those_of_the_driver(file, sections, stroke):
    text = [f"{name}: {form % LIMIT.format(value)}" for name, form, value in sections]
    assert read_driver_file(file("\n".join(text))).max_stroke == stroke


@pytest.mark.parametrize(
    ("names", "reported"),
    [
        (("/left/driver", "/right/driver"), ("/left/driver", "/right/driver")),
        (("/left/driver", "/right/**"), ("/left/driver", "/right/driver")),
        (("driver", "/right/driver"), ("/driver", "/right/driver")),
        (("/twin", "/left/tracker"), ("/twin", "/left/tracker")),
        (("/*", "/**/crawler/driver"), ("/worm/driver", "/*", "/**/crawler/driver")),
    ],
)
def test_several_drivers_or_none_are_rejected_with_their_names(file, names, reported):
    path = file("\n".join(f"{name}: {LIMIT.format(0.05)}" for name in names))
    with pytest.raises(SettingsFileError) as error:
        read_driver_file(path)
    assert all(name in str(error.value) for name in (str(path), *reported))


@pytest.mark.parametrize(
    ("text", "fact"),
    [
        *((text, "") for text in ("", "[1, 2]", "a: b", "? [x]\n: 1", "a: &b {c: *b}")),
        *((text, "YAML") for text in ("{", "%TAG !\n---\nx")),
        ("a: 1", "has no ros__parameters of /worm/driver"),
        ("driver: {ros__parameters: {cable_servos.spool_radius_m: 0.02}}", "must be a list"),
        ("driver: {ros__parameters: {cable_servos.spool_radius_m: [-1]}}", "greater than 0"),
        ("driver: {ros__parameters: {limits.max_stroke_m: true}}", "must be a valid number"),
    ],
)
def test_other_files_are_rejected(file, text, fact):
    with pytest.raises(SettingsFileError, match=f"robot\\.yaml: .*{fact}") as error:
        read_driver_file(file(text))
    assert "\n" not in str(error.value)
