# SPDX-License-Identifier: Apache-2.0
"""Reader of ROS 2 parameter files, with the sections and the precedence of rcl_yaml_param_parser.

Values are those of YAML 1.1. ROS reads some scalars otherwise: ``3e-2``, a number for ROS, is a text here.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml

from worm_msgs.yaml_file import SettingsFileError, problem_of

_CONTENT = "ros__parameters"  # key of a node's parameters
#: libyaml, which ROS uses, too; PyYAML's own parser rejects tabs that libyaml accepts.
_Loader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)

Section = tuple[str, dict[str, Any]]


def read_sections(path: str | Path) -> list[Section]:
    """Return the sections of a file in order: name of the nodes with its wildcards, and parameters by dotted name.

    A later parameter replaces an earlier one, also that of an earlier section for the same node.

    Raises:
        SettingsFileError: The file is unreadable or is not YAML. The message begins with the path.
    """
    try:
        with Path(path).open("rb") as stream:
            loader = _Loader(stream)
            found: list[Section] = []
            while loader.check_node():
                found += _sections(loader, loader.get_node())
            return found
    except OSError as error:
        raise SettingsFileError(f"{path}: cannot be read ({error.strerror})") from None
    except yaml.YAMLError as error:
        raise SettingsFileError(f"{path}: {problem_of(error)}") from None
    except ValueError as error:  # a date such as 2026-13-01
        raise SettingsFileError(f"{path}: has a value that cannot be read: {error}") from None
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


def _sections(loader: Any, node: yaml.Node, prefix: str = "") -> Iterator[Section]:
    for key, value in _items(node):
        if key == _CONTENT:
            yield prefix, dict(_parameters(loader, value))
        else:
            yield from _sections(loader, value, f"{prefix}/{key.strip('/')}")


def _parameters(loader: Any, node: yaml.Node, prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in _items(node):
        if isinstance(value, yaml.MappingNode):
            yield from _parameters(loader, value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", loader.construct_object(value, deep=True)
