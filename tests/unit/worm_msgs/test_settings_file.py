# SPDX-License-Identifier: Apache-2.0
"""Settings files: which values a dataclass accepts, and the facts in the message about each invalid file."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import pytest

from worm_msgs.settings_file import OneOf, json_schema, key, read_settings
from worm_msgs.yaml_file import SettingsFileError

MODELS = {"small": 1.5, "large": 3.0}


@dataclass(frozen=True)
class Servo:
    number: Annotated[int, key("id", ge=0, le=252)]
    radius: Annotated[float, key("radius_m", gt=0.0, le=0.5)] = 0.025
    torque: Annotated[float, key("model"), OneOf(MODELS)] = 1.5


@dataclass(frozen=True)
class Robot:
    step: Annotated[float, key("step_s")]
    moves: bool = True
    mode: Annotated[str, OneOf(("slow", "fast"))] = "slow"
    servos: tuple[Servo, ...] = ()
    places: Mapping[int, tuple[float, float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.step == 3.0:
            raise ValueError("step_s: 3 s never works")


def read(folder: Path, text: str) -> Robot:
    file = folder / "robot.yaml"
    file.write_text(text)
    return read_settings(file, Robot)


def test_a_valid_file_makes_a_dataclass(tmp_path):
    text = "step_s: 1\nservos: [{id: 4, model: large}]\nplaces: {3: [0.0, 1]}\n"
    expected = Robot(1.0, servos=(Servo(4, torque=3.0),), places={3: (0.0, 1.0)})
    robot = read(tmp_path, text)
    assert robot == expected
    assert isinstance(robot.step, float)


@pytest.mark.parametrize(
    ("text", "facts"),
    [
        ("", ["mapping", "None"]),
        ("step_s: 1\nstep_s: 2", ["YAML", "line 2", "step_s"]),
        ("step_s: 1\nplaces:\n  1: [1, 2]\n  1.0: [3, 4]", ["YAML", "line 4", "1.0"]),
        ("step_s: 2026-13-41", ["month"]),
        ("[" * 3000, ["nested"]),
        ("moves: yes", ["step_s", "missing"]),
        ("stp_s: 1", ["'stp_s'", "step_s"]),
        ('{step_s: 1, mode: "\\ud800"}', ["Unicode"]),
        ("step_s: true", ["step_s", "number", "True"]),
        ("step_s: .inf", ["step_s", "finite", "inf"]),
        ("step_s: 1e-3", ["step_s", "'1e-3'", "1.0e-3"]),
        ("step_s: 3", ["step_s", "3 s never works"]),
        ("{step_s: 1, moves: 1}", ["moves", "boolean", "1"]),
        ("{step_s: 1, mode: quick}", ["mode", "'slow'", "'fast'", "'quick'"]),
        ("{step_s: 1, servos: [{id: 1}, {id: 1.5}]}", ["servos: [1]: id", "integer", "1.5"]),
        ("{step_s: 1, servos: [{id: 253}]}", ["servos: [0]: id", "252", "253"]),
        ("{step_s: 1, servos: [{id: 1, radius_m: 25}]}", ["radius_m", "0.5", "25", "unit"]),
        ("{step_s: 1, servos: [{id: 1, radius: 1}]}", ["servos: [0]", "'radius'", "radius_m"]),
        ("{step_s: 1, servos: [{id: 1, model: tiny}]}", ["model", "'small'", "'tiny'"]),
        ("{step_s: 1, places: {a: [1, 2]}}", ["places", "integer", "'a'"]),
        ("{step_s: 1, places: {1: [1, 2, 3]}}", ["places: 1", "2 items", "[1, 2, 3]"]),
        ("{step_s: 1, places: {2026-11-23: [1, 2]}}", ["keys"]),
        ("{step_s: 1, places: &a {1: *a}}", ["YAML"]),
    ],
)
def test_an_invalid_file_is_rejected_in_one_line(tmp_path, text, facts):
    with pytest.raises(SettingsFileError) as caught:
        read(tmp_path, text)
    message = str(caught.value)
    assert message.startswith(str(tmp_path / "robot.yaml: "))
    assert "\n" not in message
    assert [fact for fact in facts if fact not in message.removeprefix(str(tmp_path))] == []


def test_a_merge_key_adds_the_keys_of_another_mapping(tmp_path):
    text = "step_s: 1\nservos: [&first {id: 1, radius_m: 0.1}, {<<: *first, id: 2}]\n"
    assert read(tmp_path, text).servos == (Servo(1, 0.1), Servo(2, 0.1))


def test_the_schema_has_the_keys_of_the_file_and_their_bounds():
    schema = json_schema(Robot)
    servo = schema["$defs"]["Servo"]
    assert schema["required"] == ["step_s"]
    assert schema["additionalProperties"] is False
    assert servo["properties"]["radius_m"]["exclusiveMinimum"] == 0.0
    assert servo["properties"]["radius_m"]["maximum"] == 0.5
    assert servo["properties"]["model"]["enum"] == ["small", "large"]
