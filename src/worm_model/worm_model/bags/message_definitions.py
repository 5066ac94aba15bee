# SPDX-License-Identifier: Apache-2.0
"""Message definitions as bags carry them: ``ros2msg`` text, root type first, then every type that it needs.

The layout is that of rosbag2 (and of MCAP's ros2msg encoding): after the root's text, per dependency a line of 80
``=``, a line ``MSG: package/Type``, and the text.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from pathlib import Path

SEPARATOR = "=" * 80
PRIMITIVES = frozenset(
    "bool byte char float32 float64 int8 uint8 int16 uint16 int32 uint32 int64 uint64 string wstring".split()
)
_FIELD = re.compile(
    r"^\s*(?P<type>[A-Za-z][\w/]*)(?:<=\d+)?(?:\[(?:<=)?\d*\])?\s+[A-Za-z]\w*\s*(?P<rest>.*)$"
)


class DefinitionError(ValueError):
    """A message definition is missing or cannot be read."""


def dependencies(text: str, package: str) -> list[str]:
    """Names ``package/Type`` of the message types that the fields of a definition use, in order, each once.

    Args:
        text: a ``.msg`` file's text.
        package: package of the definition, which names without a package belong to.
    """
    found: dict[str, None] = {}
    for line in text.splitlines():
        field = _FIELD.match(line.split("#", 1)[0])
        if field is None or field["rest"].startswith("=") or field["type"] in PRIMITIVES:
            continue  # a comment, a constant or a primitive
        name = field["type"]
        found[name if "/" in name else f"{package}/{name}"] = None
    return list(found)


def bag_schema(type_name: str, read: Callable[[str], str]) -> str:
    """Full ``ros2msg`` text of a type.

    Args:
        type_name: ``package/msg/Type``.
        read: gives the text of one definition, by ``package/Type``; raises DefinitionError when it has none.

    Raises:
        DefinitionError: the name is not one of a message, or a definition is missing.
    """
    parts = type_name.split("/")
    if len(parts) != 3 or not all(parts):
        raise DefinitionError(f"{type_name!r} is not a message type; expected package/msg/Type")
    root = f"{parts[0]}/{parts[2]}"
    texts: dict[str, str] = {}
    waiting = [root]
    while waiting:
        name = waiting.pop(0)
        if name not in texts:
            texts[name] = read(name)
            waiting += dependencies(texts[name], name.split("/")[0])
    return "\n".join(
        [texts[root], *(f"{SEPARATOR}\nMSG: {n}\n{t}" for n, t in texts.items() if n != root)]
    )


def installed_definition(name: str) -> str:
    """Text of the definition ``package/Type`` from the share folders of the sourced ROS workspaces.

    Raises:
        DefinitionError: no prefix of AMENT_PREFIX_PATH has it.
    """
    package, kind = name.split("/")
    for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        path = Path(prefix, "share", package, "msg", f"{kind}.msg")
        if prefix and path.is_file():
            return path.read_text(encoding="utf-8")
    raise DefinitionError(
        f"no definition of {package}/msg/{kind} is installed; source the workspace that has it"
    )
