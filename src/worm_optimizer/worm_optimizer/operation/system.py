# SPDX-License-Identifier: Apache-2.0
"""Reader of config/system.yaml, which describes the node graph for the launch file and all commands."""

from __future__ import annotations

import json
import math
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

from ament_index_python.packages import get_package_share_directory

from worm_model.errors import InputError
from worm_msgs.claim import domain_of
from worm_msgs.conditions import CONDITION_ROWS, Conditions
from worm_msgs.settings_file import OneOf, key, read_settings
from worm_msgs.yaml_file import unknown_name

DRIVER, RECORDER = "driver", "recorder"  # names of nodes in system.yaml
Value = bool | int | float | str | list[bool] | list[int] | list[float] | list[str]

MODES = ("robot", "virtual", "replay")
RESTARTS = 3  # largest number of restarts of an optional node
_REJECTED = 2  # exit status of a node that has rejected its input before it opened anything


@dataclass(frozen=True)
class NodeDescription:
    """Description of one node.

    Attributes:
        name: name of the node.
        package, executable: ROS package and executable of the node.
        required: True if all nodes end when this one ends. A node that is not required may be restarted.
        torque: True for the driver of a real robot. If it crashes, the servos keep their torque.
        end_timeout_s: time from an interrupt to a kill, s.
        arguments: command-line arguments.
        parameters: ROS parameters.
        remappings: new names of topics and services, by original name.
    """

    name: str
    package: str
    executable: str
    required: bool = False
    torque: bool = False
    end_timeout_s: float = 30.0
    arguments: tuple[str, ...] = ()
    parameters: Mapping[str, Value] = field(default_factory=dict)
    remappings: Mapping[str, str] = field(default_factory=dict)

    def command_arguments(self, namespace: str) -> list[str]:
        """Return the command-line arguments that start the node without a launch system."""
        result = [*self.arguments, "--ros-args"]
        result += ["-r", f"__ns:=/{namespace}", "-r", f"__node:={self.name}"]
        for source, target in self.remappings.items():
            result += ["-r", f"{source}:={target}"]
        for name, value in self.parameters.items():
            # JSON is valid YAML and keeps the types: "1" stays a string and 1.0 a float.
            result += ["-p", f"{name}:={json.dumps(value)}"]
        return result

    def end_report(self, status: int) -> str:
        """Return a message about the end of the node's process; ``status`` as in `subprocess.Popen.returncode`."""
        torque = "; torque may be on" if self.torque and status not in (0, _REJECTED) else ""
        return f"{self.name} has ended with exit status {status}{torque}"


@dataclass(frozen=True)
class System:
    """Nodes of one mode in the order of their start, and their common namespace."""

    namespace: str
    nodes: tuple[NodeDescription, ...]

    def node(self, name: str) -> NodeDescription:
        """Return the node with a name. Raises `KeyError` if this mode does not have it."""
        return {node.name: node for node in self.nodes}[name]


@dataclass(frozen=True)
class Setting:
    """Setting of a system file that can differ between starts, such as the path of a device.

    Attributes:
        default: default value.
        description: meaning.
        number: True if the value must be a finite number or empty.
    """

    default: str
    description: str
    number: bool = False


_Mode = Annotated[str, OneOf(MODES)]


@dataclass(frozen=True, kw_only=True)
class NodeRow:
    """Node in a system file. In its values, ``{name}`` is replaced by the value of the setting with this name.

    Attributes:
        modes: modes in which the node runs.
        needs: name of a setting. If the setting is empty, the node does not run.
        required: modes in which all nodes end when this one ends.
        arguments: groups of command-line arguments. A group with an empty argument is omitted.
        parameters, remappings: entries under the name of a mode are valid only in this mode.

    The other attributes are those of `NodeDescription`.
    """

    package: str
    executable: str
    modes: tuple[_Mode, ...] = MODES
    needs: str | None = None
    required: tuple[_Mode, ...] = ()
    end_timeout_s: Annotated[float, key(gt=0.0)] = 30.0
    arguments: tuple[tuple[str | int | float, ...], ...] = ()
    parameters: Mapping[str, Any] = field(default_factory=dict)
    remappings: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class SystemFile:
    """Content of a system file: default namespace, settings, and nodes that refer to the settings as {name}."""

    namespace: str
    settings: Mapping[str, Setting]
    nodes: Mapping[str, NodeRow]

    def __post_init__(self) -> None:
        """Raise `InputError` if a node refers to a setting that the file does not contain."""
        known = ("namespace", "domain", *self.settings)
        for name, row in self.nodes.items():
            for used in (*re.findall(r"\{(\w+)\}", repr(row)), row.needs):
                if used not in (None, *known):
                    raise InputError(f"nodes: {name}: {unknown_name('setting', used, known)}")

    def system(self, mode: str, namespace: str = "", **settings: str) -> System:
        """Return the system of a mode.

        Args:
            mode: one of MODES.
            namespace: namespace without the first slash, such as ``robots/worm``; empty: that of the file.
            settings: settings that differ from their defaults.
        """
        namespace = namespace or self.namespace
        unknown = sorted(set(settings) - set(self.settings))
        if unknown:
            raise InputError(unknown_name("setting", unknown[0], self.settings))
        names = {"namespace": namespace, "domain": str(domain_of(os.environ))}
        defaults = {name: row.default.format_map(names) for name, row in self.settings.items()}
        values: dict[str, str | float] = {**names, **defaults, **settings}
        for name, row in self.settings.items():
            if row.number and values[name]:
                values[name] = _number(name, str(values[name]))
        nodes = tuple(
            self._node(name, content, mode, values)
            for name, content in self.nodes.items()
            if mode in content.modes and (content.needs is None or values[content.needs])
        )
        return System(namespace, nodes)

    def _node(
        self, name: str, row: NodeRow, mode: str, values: Mapping[str, str | float]
    ) -> NodeDescription:
        return NodeDescription(
            name,
            row.package,
            row.executable,
            required=mode in row.required,
            torque=name == DRIVER and mode == "robot",
            end_timeout_s=row.end_timeout_s,
            arguments=_arguments(row.arguments, values),
            parameters=_parameters(_of_mode(row.parameters, mode), values),
            remappings=_of_mode(row.remappings, mode),
        )


def load_system_file(path: str | Path) -> SystemFile:
    """Read a system file. Raises `InputError`, whose message contains the path and the key."""
    return read_settings(Path(path), SystemFile, InputError)


def installed_system_file() -> SystemFile:
    """Return the content of the system.yaml that is installed with this package."""
    share = Path(get_package_share_directory("worm_optimizer"))
    return load_system_file(share / "config" / "system.yaml")


def _number(name: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"setting {name}: {text!r} is not a finite number")
    return value


def settings_of(conditions: Conditions) -> dict[str, str]:
    """Return conditions in the pipe as settings of a system."""
    return {name: repr(getattr(conditions, name)) for name in CONDITION_ROWS}


def _parameters(
    parameters: Mapping[str, Value], values: Mapping[str, str | float]
) -> dict[str, Value]:
    """Return parameters with settings filled in. Empty parameters are omitted, so that the node uses its defaults."""
    filled = {key: _fill(value, values) for key, value in parameters.items()}
    return {key: value for key, value in filled.items() if value != ""}


def _of_mode(rows: Mapping[str, Any], mode: str) -> dict[str, Any]:
    """Return the parameters or remappings of a mode: those for all modes, and those under the name of the mode."""
    common = {key: value for key, value in rows.items() if key not in MODES}
    return {**common, **rows.get(mode, {})}


def _arguments(
    groups: Sequence[Sequence[str | int | float]], values: Mapping[str, str | float]
) -> tuple[str, ...]:
    """Return the arguments of all groups with settings filled in. Groups with an empty argument are omitted."""
    filled = [[str(_fill(word, values)) for word in group] for group in groups]
    return tuple(word for group in filled if all(group) for word in group)


def _fill(value: Value, values: Mapping[str, str | float]) -> Value:
    """Return a value with settings filled in. A value that is ``{name}`` and nothing else gets the setting's type."""
    if not isinstance(value, str):
        return value
    alone = values.get(value[1:-1], "") if value == f"{{{value[1:-1]}}}" else ""
    return value.format_map(values) if isinstance(alone, str) else alone


@dataclass(frozen=True)
class Robot:
    """Robot, described by the system file and its settings.

    Attributes:
        file: the system file.
        mode: mode of the system file, ``robot`` or ``virtual``.
        settings: settings of the system file that differ from their defaults.
    """

    file: SystemFile
    mode: str
    settings: Mapping[str, str]

    @property
    def conditions(self) -> Conditions:
        """Conditions in the pipe according to the settings, by default those of level ground."""
        names = [name for name in CONDITION_ROWS if self.settings.get(name)]
        return Conditions(**{name: _number(name, self.settings[name]) for name in names})

    def system(self, namespace: str = "", **changes: str) -> System:
        """Return the system of this robot in a namespace (empty: that of the file), with changed settings."""
        return self.file.system(self.mode, namespace, **{**self.settings, **changes})

    def recorder(self, bag: Path, namespace: str = "") -> NodeDescription:
        """Return the recorder of this robot, which records into ``bag``."""
        return self.system(namespace, bag=str(bag)).node(RECORDER)


def recorder_of(
    namespace: str, bag: Path, parameter_file: str, conditions: Conditions
) -> NodeDescription:
    """Return the description of a recorder in the namespace of a running robot.

    Args:
        namespace: the robot's namespace.
        bag: path of a new bag, see `bring_up.new_bag`.
        parameter_file: parameter file to store in the bag; empty: none.
        conditions: conditions to store in the bag.
    """
    file = str(Path(parameter_file).resolve()) if parameter_file else ""
    settings = settings_of(conditions) | {"parameter_file": file}
    return Robot(installed_system_file(), "robot", settings).recorder(bag, namespace.strip("/"))
