# SPDX-License-Identifier: Apache-2.0
"""Reader of ROS 2 parameter files, with the values and the precedence of rcl_yaml_param_parser.

ROS accepts files that PyYAML does not construct, such as several documents and tabs after a colon. It also reads some
scalars otherwise, such as ``3e-2`` and ``null``.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml

from worm_msgs.yaml_file import SettingsFileError, problem_of

_CONTENT = "ros__parameters"  # key of a node's parameters
_TRUE = {case(word) for word in ("y", "yes", "true", "on") for case in (str, str.title, str.upper)}
_FALSE = {
    case(word) for word in ("n", "no", "false", "off") for case in (str, str.title, str.upper)
}
_INTEGER = re.compile(r"[-+]?(0[xX][0-9a-fA-F]+|0[0-7]*|[1-9][0-9]*)")
_FLOAT = re.compile(r"[-+]?(\.?(inf|nan)|infinity|([0-9]+\.?[0-9]*|\.[0-9]+)(e[-+]?[0-9]+)?)", re.I)
#: libyaml, which ROS uses, too; PyYAML's own parser rejects tabs that libyaml accepts.
_Loader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)

Section = tuple[str, dict[str, Any]]


def read_sections(path: str | Path) -> list[Section]:
    """Return the sections of a file in order: name of the nodes with its wildcards, and parameters by dotted name.

    A later parameter replaces an earlier one, also that of an earlier section for the same node.
    """
    try:
        with Path(path).open("rb") as stream:
            return [each for root in yaml.compose_all(stream, _Loader) for each in _sections(root)]
    except OSError as error:
        raise SettingsFileError(f"{path}: cannot be read ({error.strerror})") from None
    except yaml.YAMLError as error:
        raise SettingsFileError(f"{path}: {problem_of(error)}") from None
    except RecursionError:
        raise SettingsFileError(f"{path}: is nested too deeply") from None


def matches(pattern: str, name: str) -> bool:
    """Return True if the name of a section applies to a node: * is one part of a name, ** any number of parts."""
    parts = (
        "(/[^/]+)*" if part == "**" else "/" + re.escape(part).replace(r"\*", "[^/]+")
        for part in pattern.split("/")[1:]
    )
    return re.fullmatch("".join(parts), name) is not None


def _items(node: yaml.Node | None) -> list[tuple[str, yaml.Node]]:
    pairs = node.value if isinstance(node, yaml.MappingNode) else []
    return [(str(key.value), value) for key, value in pairs]


def _sections(node: yaml.Node | None, prefix: str = "") -> Iterator[Section]:
    for key, value in _items(node):
        if key == _CONTENT:
            yield prefix, dict(_parameters(value))
        else:
            yield from _sections(value, f"{prefix}/{key.strip('/')}")


def _parameters(node: yaml.Node, prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in _items(node):
        if isinstance(value, yaml.MappingNode):
            yield from _parameters(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", _value(value)


def _value(node: yaml.Node) -> Any:
    """Return the value of a node as ROS reads it, without regard to tags."""
    if isinstance(node, yaml.SequenceNode):
        return [_value(each) for each in node.value]
    text = str(node.value)
    if isinstance(node, yaml.ScalarNode) and node.style:  # quoted
        return text
    if text in _TRUE or text in _FALSE:
        return text in _TRUE
    if _INTEGER.fullmatch(text):
        value = int(re.sub("^([-+]?)0(?=[0-7])", r"\g<1>0o", text), 0)
        return value if abs(value) < 2**63 else float(value)
    return (
        float(text.lower().replace(".i", "i").replace(".n", "n"))
        if _FLOAT.fullmatch(text)
        else text
    )
