# SPDX-License-Identifier: Apache-2.0
"""Message definitions: search for installed definitions, their text inside bags, and their fields.

The text has the format ``ros2msg`` of rosbag2 and MCAP. It contains the root type's text and, for each type that it
needs, a line of 80 ``=``, a line ``MSG: package/Type``, and its text. Reading a bag requires no installed
definitions, because the bag contains them. For writing, the definitions come from the sourced workspaces
(AMENT_PREFIX_PATH). For types that these lack, the definitions of worm_msgs come from the checkout that contains this
package, and those of standard types come from `rosbags`.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from textwrap import shorten
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.typesys import (
    Stores,
    TypesysError,
    get_types_from_idl,
    get_types_from_msg,
    get_typestore,
)
from rosbags.typesys.store import Typestore

from worm_model.bags.formats.bag_errors import DefinitionError
from worm_model.bags.formats.message_block import Topic

PACKAGE = "worm_msgs"
SEPARATOR = "=" * 80
REMEDY = "source the workspace with the definitions of the time of the recording"
REASON_LENGTH = 200  # shown characters of a parser's error, which repeats the definition
_CONSTANT = re.compile(r"[A-Za-z]\w*\s+[A-Z]\w*\s*=")
# texts and characters (first group), and comments
_IDL_TEXT = re.compile(r"""(?s)("(?:\\.|[^"\\])*"|'(?:\\.|[^'\\])')|//[^\n]*|/\*.*?\*/""")
_IDL_ANNOTATION = re.compile(r"@(?:::)?\w+(?:::\w+)*(?:\s*\((?:[^()]|\([^()]*\))*\))?")
_IDL_CONSTANT = re.compile(
    r"\bconst\s+(?!(?:u?int\d+|octet|(?:unsigned\s+)?(?:short|long(?:\s+long)?))\s)[^;]*;"
)
_IDL_EMPTY_MODULE = re.compile(r"\bmodule\s+\w+\s*\{\s*\}\s*;")
_UNREADABLE = (TypesysError, ValueError, KeyError, IndexError, RecursionError)

Fields = list[tuple[str, Any]]
Types = Mapping[str, Fields]


# --- installed definitions ------------------------------------------------------------------------


def _installed_text(package: str, kind: str) -> str:
    prefixes = filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep))
    folders = [Path(prefix, "share", package, "msg") for prefix in prefixes]
    if package == PACKAGE:
        folders.append(Path(__file__).resolve().parents[4] / PACKAGE / "msg")
    for folder in folders:
        path = folder / f"{kind}.msg"
        if path.is_file():
            return path.read_text(encoding="utf-8")
    standard, name = _standard_types(), f"{package}/msg/{kind}"
    if name not in standard.fielddefs:
        raise DefinitionError(
            f"no definition of {name} is installed; source the workspace that has it"
        )
    return standard.generate_msgdef(name, ros_version=2)[0].split(SEPARATOR)[0]


@lru_cache(maxsize=1)
def _standard_types() -> Typestore:
    return get_typestore(Stores.ROS2_JAZZY)


@lru_cache(maxsize=256)
def installed_definition(type_name: str) -> str:
    """Return the ``ros2msg`` text of an installed type with all types that it needs.

    Args:
        type_name: ``package/msg/Type``.
    """
    package, _, kind = type_name.partition("/msg/")
    if not (package and kind) or "/" in package + kind:
        raise DefinitionError(f"{type_name!r} is not a message type; expected package/msg/Type")
    texts: dict[str, str] = {}
    waiting = [type_name]
    while waiting:
        name = waiting.pop(0)
        if name in texts:
            continue
        package, _, kind = name.partition("/msg/")
        texts[name] = _installed_text(package, kind)
        with suppress(*_UNREADABLE):  # errors are reported by `parse_types`
            (_, fields) = get_types_from_msg(_plain_msg(texts[name]), name)[name]
            waiting += [needed for _, field in fields for needed in _named(field)]
    parts = [
        text if name == type_name else f"{SEPARATOR}\nMSG: {name.replace('/msg/', '/')}\n{text}"
        for name, text in texts.items()
    ]
    return "\n".join(part.rstrip("\n") + "\n" for part in parts)


def _named(field: Any) -> Iterator[str]:
    """Yield the message types that a field consists of."""
    kind, argument = field
    if kind == Nodetype.NAME:
        yield argument
    elif kind != Nodetype.BASE:
        yield from _named(argument[0])


@lru_cache(maxsize=256)
def topic_of(name: str, type_name: str, offered_qos: str = "") -> Topic:
    """Return a topic for writing, with its type hash, and the definitions of its type and of all types that it needs.

    Args:
        name, type_name: full name of the topic and its type.
        offered_qos: quality of service of the publishers, YAML.
    """
    definition = installed_definition(type_name)
    metadata = (
        ("offered_qos_profiles", offered_qos),
        ("topic_type_hash", type_hash(type_name, definition, "ros2msg")),
    )
    return Topic(name, type_name, 0, definition, "ros2msg", "cdr", metadata)


def parse_ahead(type_names: Iterable[str]) -> None:
    """Parse definitions now rather than with the first bag that contains messages of these types.

    The function ends at the first type that is not installed. This is not an error, because a bag may contain all
    definitions.
    """
    with suppress(DefinitionError):
        for type_name in type_names:
            topic_of("", type_name)


# --- content of a definition ----------------------------------------------------------------------


def parse_types(type_name: str, definition: str, definition_format: str) -> Types:
    """Return the fields of a type and of all types that it needs."""
    store = typestore(type_name, definition, definition_format)
    return {name: fields for name, (_, fields) in store.fielddefs.items()}


@lru_cache(maxsize=256)  # the parser is slow
def typestore(type_name: str, definition: str, definition_format: str) -> Typestore:
    """Return the types of a definition as a store of `rosbags`, which decodes and encodes messages."""
    try:
        if definition_format == "ros2idl":
            types = get_types_from_idl(_plain_idl(definition))
        else:
            types = get_types_from_msg(_plain_msg(definition), type_name)
        for name in [type_name, *(n for _, fs in types.values() for _, f in fs for n in _named(f))]:
            if name not in types:
                raise DefinitionError(f"the definition of {name} is missing")
        store = get_typestore(Stores.EMPTY)
        store.register(types)
    except DefinitionError:
        raise
    except (*_UNREADABLE, SyntaxError) as error:  # SyntaxError: in the code that rosbags generates
        reason = shorten(str(error), REASON_LENGTH, placeholder=" …")
        raise DefinitionError(f"the definition of {type_name} cannot be read: {reason}") from None
    return store


def _plain_msg(definition: str) -> str:
    """Return the lines of a definition that determine the layout, without comments and constants."""
    lines = (line.split("#", 1)[0].strip() for line in definition.splitlines())
    return "\n".join(line for line in lines if line and not _CONSTANT.match(line)) + "\n"


def _plain_idl(definition: str) -> str:
    """Return the parts of an IDL definition as one text that `rosbags` can parse, with the same layout.

    Parts follow the parts that they include. Included files are parts of the definition. Omitted are comments,
    annotations and constants other than integers, which determine no layout, and modules without content.
    """
    parts = definition.split(f"{SEPARATOR}\n")
    text = "\n".join(re.sub(r"\AIDL:.*", "", part) for part in reversed(parts))
    text = re.sub(r"(?m)^[ \t]*#.*", "", text)  # includes, and other directives of the preprocessor
    text = _IDL_TEXT.sub(lambda match: '""' if match[1] else " ", text)
    for omitted in (_IDL_ANNOTATION, _IDL_CONSTANT):
        text = omitted.sub(" ", text)
    while (shorter := _IDL_EMPTY_MODULE.sub(" ", text)) != text:
        text = shorter
    return text


@lru_cache(maxsize=256)
def type_hash(type_name: str, definition: str, definition_format: str) -> str:
    """Return the RIHS01 hash of a type; empty if `rosbags` cannot compute it."""
    store = typestore(type_name, definition, definition_format)
    try:
        return str(store.hash_rihs01(type_name))
    except (TypesysError, KeyError, ValueError, RecursionError):  # of a type that contains itself
        return ""


def with_definition(topic: Topic) -> Topic:
    """Return the topic with the definition that fits its type hash: its own, or else the installed one.

    The two disagree, for example, if a bag was rewritten in a newer workspace. If neither fits, its own one counts.
    """
    if topic.definition and _fits(topic):
        return topic
    if not topic.type_name:
        raise DefinitionError(f"{topic.name} has neither a type nor a definition")
    try:
        found = topic_of(topic.name, topic.type_name, topic.offered_qos)
    except DefinitionError:
        if topic.definition:
            return topic
        raise
    if topic.type_hash in ("", found.type_hash):
        return replace(found, count=topic.count)
    if topic.definition:
        return topic
    raise DefinitionError(
        f"the type hash of {topic.name} differs from that of the installed {topic.type_name}; {REMEDY}"
    )


def _fits(topic: Topic) -> bool:
    try:
        found = type_hash(topic.type_name, topic.definition, topic.definition_format)
    except DefinitionError:
        return not topic.type_hash
    return "" in (found, topic.type_hash) or found == topic.type_hash
