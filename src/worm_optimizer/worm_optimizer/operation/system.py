# SPDX-License-Identifier: Apache-2.0
"""The node graph as data: config/system.yaml, read by the launch file and by the demo alike."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

Value = bool | int | float | str | list[bool] | list[int] | list[float] | list[str]

MODES = ("robot", "virtual", "replay")
RESTARTS = 3  # of a node that is not required, where the nodes are to stay up
_SYSTEM_KEYS = {"namespace", "settings", "nodes"}


class SystemFileError(ValueError):
    """A system file is malformed, or a setting that it knows nothing of was given."""


@dataclass(frozen=True)
class NodeDescription:
    """One node: what runs, under which name, with which arguments, parameters and remappings.

    ``ready`` is what a line of its output contains once the nodes after it may start; empty when
    they need not wait. A ``lifecycle`` node is to be configured and activated. All end with a
    ``required`` one; another is started again. ``at_rest_within`` is what stands, in a line of its
    output, before the time (s) that it may take to end after a signal; empty when it ends at once.
    """

    name: str
    package: str
    executable: str
    ready: str = ""
    lifecycle: bool = False
    required: bool = False
    at_rest_within: str = ""
    arguments: tuple[str, ...] = ()
    parameters: Mapping[str, Value] = field(default_factory=dict)
    remappings: Mapping[str, str] = field(default_factory=dict)

    def command_arguments(self, namespace: str) -> list[str]:
        """The arguments that tell the executable all of this without a launch system."""
        result = [*self.arguments, "--ros-args"]
        result += ["-r", f"__ns:=/{namespace}", "-r", f"__node:={self.name}"]
        for source, target in self.remappings.items():
            result += ["-r", f"{source}:={target}"]
        for key, value in self.parameters.items():
            # JSON is YAML: "1" stays a string and 1.0 a float
            result += ["-p", f"{key}:={json.dumps(value)}"]
        return result


# Of a node in a system file; the plain ones go into its description as they are.
_PLAIN_KEYS = ("ready", "lifecycle", "required", "at_rest_within")
_NODE_KEYS = (
    *("package", "executable", "modes", "needs", *_PLAIN_KEYS),
    *("arguments", "parameters", "remappings"),
)


@dataclass(frozen=True)
class System:
    """The nodes of one mode, in the order in which they start, and their common namespace."""

    namespace: str
    nodes: tuple[NodeDescription, ...]

    def node(self, name: str) -> NodeDescription:
        """The node of a name; raises `KeyError` if this mode has none."""
        return {node.name: node for node in self.nodes}[name]


@dataclass(frozen=True)
class Setting:
    """What may differ from start to start, such as the path of a device."""

    default: str
    description: str


@dataclass(frozen=True)
class SystemFile:
    """A parsed system file: settings, and nodes that refer to them as {name}."""

    path: Path
    namespace: str
    settings: Mapping[str, Setting]
    nodes: Mapping[str, Mapping[str, Any]]

    def system(self, mode: str, namespace: str = "", **settings: str) -> System:
        """The system of a mode, with some settings other than their defaults.

        ``namespace`` is without its first slash, such as ``robots/worm``; empty: the file's own.
        Raises `SystemFileError` on an unknown mode or setting.
        """
        namespace = namespace or self.namespace
        if mode not in MODES:
            raise SystemFileError(f"mode {mode!r}: choose one of {', '.join(MODES)}")
        unknown = sorted(set(settings) - set(self.settings))
        if unknown:
            known = ", ".join(self.settings)
            raise SystemFileError(f"no setting {unknown[0]!r} in {self.path}: there are {known}")
        names = {"namespace": namespace}
        defaults = {name: row.default.format_map(names) for name, row in self.settings.items()}
        values = {**names, **defaults, **settings}
        return System(
            namespace,
            tuple(
                self._node(name, content, mode, values)
                for name, content in self.nodes.items()
                if mode in content.get("modes", MODES) and _is_wanted(content, values)
            ),
        )

    def _node(
        self, name: str, content: Mapping[str, Any], mode: str, values: Mapping[str, str]
    ) -> NodeDescription:
        parameters = _of_mode(content.get("parameters", {}), mode)
        try:
            return NodeDescription(
                name,
                package=content["package"],
                executable=content["executable"],
                **{key: content[key] for key in _PLAIN_KEYS if key in content},
                arguments=_arguments(content.get("arguments", ()), values),
                parameters=_parameters(parameters, values),
                remappings=_of_mode(content.get("remappings", {}), mode),
            )
        except KeyError as error:
            raise SystemFileError(f"{self.path}: node {name}: no setting or key {error}") from None


def load_system_file(path: str | Path) -> SystemFile:
    """Read a system file; raises `SystemFileError`, whose message names the path and the key."""
    path = Path(path)
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, yaml.YAMLError) as error:
        raise SystemFileError(f"{path}: {error}") from None
    if not isinstance(content, Mapping) or set(content) != _SYSTEM_KEYS:
        raise SystemFileError(f"{path}: expected the keys {', '.join(sorted(_SYSTEM_KEYS))}")
    for name, node in content["nodes"].items():
        unknown = sorted(set(node) - set(_NODE_KEYS))
        if unknown:
            known = ", ".join(sorted(_NODE_KEYS))
            raise SystemFileError(f"{path}: node {name}: unknown key {unknown[0]}, known: {known}")
    try:
        settings = {name: Setting(**value) for name, value in content["settings"].items()}
    except TypeError:
        raise SystemFileError(f"{path}: a setting has a default and a description") from None
    return SystemFile(path, content["namespace"], settings, content["nodes"])


def _parameters(parameters: Mapping[str, Value], values: Mapping[str, str]) -> dict[str, Value]:
    """Parameters with their values filled in; without a value, the node's file or its default holds."""
    filled = {key: _fill(value, values) for key, value in parameters.items()}
    return {key: value for key, value in filled.items() if value != ""}


def _of_mode(rows: Mapping[str, Any], mode: str) -> dict[str, Any]:
    """The parameters or remappings common to all modes (those with a plain value) and those of one mode."""
    common = {key: value for key, value in rows.items() if key not in MODES}
    return {**common, **rows.get(mode, {})}


def _is_wanted(content: Mapping[str, Any], values: Mapping[str, str]) -> bool:
    """Whether the setting that a node needs, if any, has a value."""
    return "needs" not in content or bool(values[content["needs"]])


def _arguments(groups: Sequence[Sequence[str]], values: Mapping[str, str]) -> tuple[str, ...]:
    """The words of all groups; a group with an empty word is left out as a whole."""
    filled = [[str(_fill(word, values)) for word in group] for group in groups]
    return tuple(word for group in filled if all(group) for word in group)


def _fill(value: Value, values: Mapping[str, str]) -> Value:
    return value.format_map(values) if isinstance(value, str) else value
