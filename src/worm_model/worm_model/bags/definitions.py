# SPDX-License-Identifier: Apache-2.0
"""Message definitions for bags that are written here, and for those that carry none.

Reading needs nothing installed: a bag carries its definitions. Writing does, and takes those of worm_msgs from
where they are defined: from the workspace that is sourced (AMENT_PREFIX_PATH), else from the checkout that this package
lies in or was installed from with ``pip install --editable``. Standard types come with `rosbags`.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from contextlib import suppress
from functools import lru_cache
from pathlib import Path

from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from worm_model.bags.bag import Topic
from worm_model.bags.bag_errors import BagError
from worm_model.bags.cdr import Types, parse_types, without_comments

PACKAGE = "worm_msgs"
SEPARATOR = "=" * 80
HEADER = "builtin_interfaces/Time stamp\nstring frame_id\n"  # std_msgs/msg/Header


def _folders() -> Iterator[Path]:
    for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        if prefix:
            yield Path(prefix, "share", PACKAGE, "msg")
    yield Path(__file__).resolve().parents[3] / PACKAGE / "msg"


def definition_files() -> dict[str, Path]:
    """Paths of worm_msgs' message definitions by type name.

    Raises:
        BagError: they are nowhere to be found.
    """
    for folder in _folders():
        files = sorted(folder.glob("*.msg"))
        if files:
            return {f"{PACKAGE}/msg/{path.stem}": path for path in files}
    raise BagError(
        f"the definitions of {PACKAGE} are not installed; source the workspace, or install worm_model "
        "from its checkout with pip install --editable"
    )


@lru_cache(maxsize=1)
def _own_store() -> Typestore:
    """worm_msgs and what they need: making all standard types takes ten times as long."""
    store = get_typestore(Stores.EMPTY)
    found = get_types_from_msg(HEADER, "std_msgs/msg/Header")
    for type_name, path in definition_files().items():
        text = without_comments(path.read_text(encoding="utf-8"))
        found.update(get_types_from_msg(text, type_name))
    store.register(found)
    return store


@lru_cache(maxsize=1)
def _standard_store() -> Typestore:
    return get_typestore(Stores.ROS2_JAZZY)


def _store_of(type_name: str) -> Typestore:
    own = _own_store()
    return own if type_name in own.fielddefs else _standard_store()


@lru_cache(maxsize=64)
def installed_types(type_name: str) -> Types:
    """Fields of a type of worm_msgs or of a standard package of ROS 2 Jazzy, and of all that it needs, by type name.

    Raises:
        BagError: worm_msgs is nowhere to be found.
    """
    store = _store_of(type_name)
    return {name: list(fields) for name, (_, fields) in store.fielddefs.items()}


@lru_cache(maxsize=64)
def topic_of(name: str, type_name: str, offered_qos: str = "") -> Topic:
    """A topic that can be written: definition with all that it needs, type hash, offered QoS (YAML).

    Raises:
        BagError: the type is not known.
    """
    store = _store_of(type_name)
    if type_name not in store.fielddefs:
        raise BagError(f"{type_name} is neither in {PACKAGE} nor a standard type")
    definition = _definition(store, type_name)
    metadata = (
        ("offered_qos_profiles", offered_qos),
        ("topic_type_hash", store.hash_rihs01(type_name)),
    )
    return Topic(name, type_name, 0, definition, "ros2msg", "cdr", metadata)


def _definition(store: Typestore, type_name: str) -> str:
    """``ros2msg`` text; worm_msgs' own texts keep their comments, which hold the units."""
    generated, _ = store.generate_msgdef(type_name, ros_version=2)
    files = definition_files()
    first, *others = generated.split(f"{SEPARATOR}\nMSG: ")
    parts = [files[type_name].read_text(encoding="utf-8") if type_name in files else first]
    for other in others:
        name, text = other.split("\n", 1)
        path = files.get(name.replace("/", "/msg/"))
        parts.append(
            f"{SEPARATOR}\nMSG: {name}\n{path.read_text(encoding='utf-8') if path else text}"
        )
    return "\n".join(part.rstrip("\n") + "\n" for part in parts)


def parse_ahead(type_names: Iterable[str]) -> None:
    """Parse definitions of worm_msgs now rather than with the first bag that holds, or gets, messages of these types.

    Where worm_msgs is not installed, nothing happens: a bag may carry all that is needed.
    """
    with suppress(BagError):
        for type_name in type_names:
            installed_types(type_name)
            topic = topic_of("", type_name)
            parse_types(type_name, topic.definition, topic.definition_format)
