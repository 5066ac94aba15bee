# SPDX-License-Identifier: Apache-2.0
"""Reader of YAML files that a person edits."""

import difflib
from collections.abc import Collection, Hashable
from pathlib import Path
from typing import Any

import yaml

from worm_msgs.input_error import InputError


class SettingsFileError(InputError):
    """A file or its content is invalid. The message is one line that names the fault and, if known, key and value."""


def read_yaml(path: Path, error: type[Exception] = SettingsFileError) -> Any:
    """Return the content of a YAML file. Duplicate keys are rejected."""
    try:
        return parse_yaml(path.read_text(encoding="utf-8"))
    except OSError as problem:
        raise error(f"{path}: cannot be read ({problem.strerror})") from None
    except UnicodeDecodeError:
        raise error(f"{path}: is not a text file") from None
    except SettingsFileError as problem:
        raise error(f"{path}: {problem}") from None


def parse_yaml(text: str) -> Any:
    """Return the content of a YAML text. Raises SettingsFileError, also for a duplicate key."""
    try:
        return yaml.load(text, _Loader)
    except yaml.YAMLError as error:
        raise SettingsFileError(problem_of(error)) from None
    except ValueError as error:  # a date such as 2026-13-01
        raise SettingsFileError(f"contains a value that cannot be read: {error}") from None
    except RecursionError:
        raise SettingsFileError("is nested too deeply") from None


def problem_of(error: yaml.YAMLError) -> str:
    """Return an error of PyYAML in one line, with the line of the file if it is known."""
    mark = getattr(error, "problem_mark", None)
    line = f" at line {mark.line + 1}" if mark else ""
    problem = getattr(error, "problem", None) or str(error).splitlines()[0]
    return f"is not valid YAML{line}: {problem}"


_MERGE = "tag:yaml.org,2002:merge"  # tag of the key <<


class _Loader(yaml.SafeLoader):
    """YAML loader that rejects duplicate keys. PyYAML would silently drop the first of two equal keys."""


def _unique_mapping(loader: _Loader, node: yaml.MappingNode) -> dict[Hashable, Any]:
    before: set[Hashable] = set()  # for Python, 1 equals 1.0 and true
    for key_node, _ in node.value:
        if key_node.tag == _MERGE:
            continue
        name = loader.construct_object(key_node, deep=True)
        if not isinstance(name, Hashable):
            continue  # rejected below
        if name in before:
            raise yaml.MarkedYAMLError(
                problem=f"duplicate key {name}", problem_mark=key_node.start_mark
            )
        before.add(name)
    return yaml.SafeLoader.construct_mapping(loader, node, deep=True)


_Loader.add_constructor(yaml.resolver.BaseResolver.DEFAULT_MAPPING_TAG, _unique_mapping)


def unknown_name(kind: str, name: str, known: Collection[str]) -> str:
    """Return a message that a name is unknown. The message names the most similar known name, else all known names."""
    near = difflib.get_close_matches(name, known, n=1)
    hint = f"did you mean {near[0]}?" if near else f"there are {', '.join(known)}"
    return f"no {kind} {name!r}: {hint}"
