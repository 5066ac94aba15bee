# SPDX-License-Identifier: Apache-2.0
"""Definitions as bags carry them, against every message type that is installed."""

import os
from pathlib import Path

import pytest
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from worm_model.bags.message_definitions import (
    DefinitionError,
    bag_schema,
    dependencies,
    installed_definition,
)

WORM_MSGS = Path(__file__).resolve().parents[3] / "src" / "worm_msgs" / "msg"


def installed() -> list[Path]:
    prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    files = [path for p in prefixes if p for path in Path(p, "share").glob("*/msg/*.msg")]
    return sorted({(f.parts[-3], f.name): f for f in [*files, *WORM_MSGS.glob("*.msg")]}.values())


def package_of(path: Path) -> str:
    return path.parts[-3]


def nested(description) -> set[str]:
    kind, argument = description
    if kind == Nodetype.NAME:
        return {argument.replace("/msg/", "/")}
    return nested(argument[0]) if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE) else set()


@pytest.mark.parametrize("path", installed(), ids=lambda p: f"{package_of(p)}/{p.stem}")
def test_dependencies_are_those_that_an_independent_parser_finds(path: Path):
    name = f"{package_of(path)}/msg/{path.stem}"
    text = path.read_text(encoding="utf-8")
    fields = get_types_from_msg(text, name)[name][1]
    expected = set().union(*(nested(description) for _, description in fields))
    assert set(dependencies(text, package_of(path))) == expected


@pytest.mark.parametrize("path", sorted(WORM_MSGS.glob("*.msg")), ids=lambda p: p.stem)
def test_a_schema_holds_all_that_the_type_needs_and_has_its_hash(path: Path):
    if not os.environ.get("AMENT_PREFIX_PATH"):
        pytest.skip("no workspace is sourced")
    name = f"worm_msgs/msg/{path.stem}"
    schema = bag_schema(name, installed_definition)
    alone = get_typestore(Stores.EMPTY)
    alone.register(get_types_from_msg(schema, name))
    described = Path(installed_file("worm_msgs", path.stem)).read_text(encoding="utf-8")
    assert alone.hash_rihs01(name) in described


def installed_file(package: str, kind: str) -> Path:
    """The type description that the interface generator installed, which holds the hash."""
    for prefix in os.environ["AMENT_PREFIX_PATH"].split(os.pathsep):
        path = Path(prefix, "share", package, "msg", f"{kind}.json")
        if path.is_file():
            return path
    raise AssertionError(f"{package}/msg/{kind} is not installed")


def test_the_layout_is_that_of_rosbag2():
    texts = {
        "a/Root": "b/Leaf leaf\nTwin[2] twins\nint8 K=3  # b/No no\n",
        "b/Leaf": "string<=5 name 'x'\n",
        "a/Twin": "b/Leaf leaf\n",
    }
    assert bag_schema("a/msg/Root", texts.__getitem__) == (
        texts["a/Root"]
        + f"\n{'=' * 80}\nMSG: b/Leaf\n{texts['b/Leaf']}"
        + f"\n{'=' * 80}\nMSG: a/Twin\n{texts['a/Twin']}"
    )


@pytest.mark.parametrize("name", ["Tracker", "worm_msgs/Tracker", "worm_msgs//Tracker", ""])
def test_what_is_no_message_type_is_refused(name: str):
    with pytest.raises(DefinitionError, match="not a message type"):
        bag_schema(name, lambda _: "")


def test_a_type_that_is_not_installed_is_named():
    with pytest.raises(DefinitionError, match="no_msgs/msg/Such"):
        bag_schema("no_msgs/msg/Such", installed_definition)
