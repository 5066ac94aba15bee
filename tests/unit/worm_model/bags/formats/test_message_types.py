# SPDX-License-Identifier: Apache-2.0
"""Definitions as bags contain them, compared with every installed message type."""

import os
from pathlib import Path

import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from worm_model.bags.formats.bag_errors import DefinitionError
from worm_model.bags.formats.message_block import Topic
from worm_model.bags.formats.message_types import (
    installed_definition,
    parse_types,
    topic_of,
    with_definition,
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
        described = installed_file(package, path.stem).read_text(encoding="utf-8")
        assert alone.hash_rihs01(name) in described


def installed_file(package: str, kind: str) -> Path:
    """Return the type description that the interface generator installed, which contains the hash."""
    for prefix in os.environ["AMENT_PREFIX_PATH"].split(os.pathsep):
        path = Path(prefix, "share", package, "msg", f"{kind}.json")
        if path.is_file():
            return path
    raise AssertionError(f"{package}/msg/{kind} is not installed")


def test_the_layout_is_that_of_rosbag2(tmp_path: Path, monkeypatch):
    texts = {
        "a/Root": "b/Leaf leaf\nTwin[2] twins\nint8 K=3  # b/No no\n",
        "b/Leaf": "string<=5 name 'x'\n",
        "a/Twin": "b/Leaf leaf\n",
    }
    for name, text in texts.items():
        package, kind = name.split("/")
        folder = tmp_path / "share" / package / "msg"
        folder.mkdir(parents=True, exist_ok=True)
        (folder / f"{kind}.msg").write_text(text)
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    assert installed_definition("a/msg/Root") == (
        texts["a/Root"]
        + f"\n{'=' * 80}\nMSG: b/Leaf\n{texts['b/Leaf']}"
        + f"\n{'=' * 80}\nMSG: a/Twin\n{texts['a/Twin']}"
    )


@pytest.mark.parametrize(
    "name", ["Tracker", "worm_msgs/Tracker", "worm_msgs//Tracker", "", "no_msgs/msg/Such"]
)
def test_an_invalid_or_missing_message_type_is_rejected(name: str):
    with pytest.raises(DefinitionError, match=name or "not a message type"):
        installed_definition(name)


def without_definition(type_hash: str) -> Topic:
    metadata = (("topic_type_hash", type_hash), ("offered_qos_profiles", "- depth: 1\n"))
    return Topic("/worm/power", "worm_msgs/msg/Power", 3, "", "", "cdr", metadata)


def test_a_topic_without_definition_gets_the_installed_one():
    known = topic_of("/worm/power", "worm_msgs/msg/Power")
    for type_hash in ("", known.type_hash):
        topic = with_definition(without_definition(type_hash))
        assert (topic.definition, topic.type_hash) == (known.definition, known.type_hash)
        assert (topic.count, topic.offered_qos) == (3, "- depth: 1\n")


def test_a_topic_whose_hash_is_not_that_of_the_installed_type_is_rejected():
    with pytest.raises(DefinitionError, match="type hash"):
        with_definition(without_definition("RIHS01_" + "0" * 64))
