# SPDX-License-Identifier: Apache-2.0
"""Definitions as bags contain them, compared with every installed message type."""

import os
from pathlib import Path

import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from worm_model.bags.formats.bag_errors import DefinitionError
from worm_model.bags.formats.message_types import (
    SEPARATOR,
    installed_definition,
    parse_types,
)

WORM_MSGS = Path(__file__).resolve().parents[5] / "src" / "worm_msgs" / "msg"


def installed() -> list[Path]:
    prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    files = [path for p in prefixes if p for path in Path(p, "share").glob("*/msg/*.msg")]
    return sorted({(f.parts[-3], f.name): f for f in [*files, *WORM_MSGS.glob("*.msg")]}.values())


@pytest.mark.parametrize("path", installed(), ids=lambda p: f"{p.parts[-3]}/{p.stem}")
def test_a_definition_holds_all_that_the_type_needs(path: Path):
    """An independent store without other definitions accepts it, and computes the same hash."""
    package = path.parts[-3]
    name = f"{package}/msg/{path.stem}"
    definition = installed_definition(name)
    assert definition.startswith(path.read_text(encoding="utf-8").rstrip("\n"))
    alone = get_typestore(Stores.EMPTY)
    alone.register(get_types_from_msg(definition, name))
    assert set(parse_types(name, definition, "ros2msg")) == set(alone.fielddefs)
    if package == "worm_msgs" and os.environ.get("AMENT_PREFIX_PATH"):
        described = installed_file(name, "json").read_text(encoding="utf-8")
        assert alone.hash_rihs01(name) in described


def installed_file(name: str, kind: str) -> Path:
    """Return what the interface generator installed for a type: its IDL, or its description with the hash."""
    for prefix in os.environ["AMENT_PREFIX_PATH"].split(os.pathsep):
        path = Path(prefix, "share", f"{name}.{kind}")
        if path.is_file():
            return path
    raise AssertionError(f"{name} is not installed")


@pytest.mark.skipif(not os.environ.get("AMENT_PREFIX_PATH"), reason="no ROS is installed")
@pytest.mark.parametrize(
    "name",
    [
        "sensor_msgs/msg/JointState",
        "sensor_msgs/msg/PointCloud2",
        *(f"worm_msgs/msg/{path.stem}" for path in sorted(WORM_MSGS.glob("*.msg"))),
    ],
)
def test_idl_as_rosidl_emits_it_gives_the_fields_of_the_same_message(name: str):
    fields = parse_types(name, installed_definition(name), "ros2msg")
    parts = [(part, installed_file(part, "idl").read_text(encoding="utf-8")) for part in fields]
    idl = "".join(f"{SEPARATOR}\nIDL: {part}\n{text}" for part, text in parts)
    assert parse_types(name, idl, "ros2idl") == fields


@pytest.mark.parametrize(
    "name", ["Tracker", "worm_msgs/Tracker", "worm_msgs//Tracker", "", "no_msgs/msg/Such"]
)
def test_an_invalid_or_missing_message_type_is_rejected(name: str):
    with pytest.raises(DefinitionError, match=name or "not a message type"):
        installed_definition(name)
