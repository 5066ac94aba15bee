# SPDX-License-Identifier: Apache-2.0
"""Command line and declaration of the parameters of a node.

If a node cannot use an argument, a parameter or a file, it prints one line and exits with status 2. A node that ignored
such input could run the robot with wrong values, for example with the parameter file of another robot.
"""

from __future__ import annotations

import argparse
import difflib
import math
import sys
from array import array
from collections.abc import Callable, Sequence
from itertools import pairwise
from types import ModuleType
from typing import Any

from rcl_interfaces.msg import SetParametersResult
from rclpy.exceptions import ParameterException
from rclpy.node import Node
from rclpy.parameter import Parameter

from worm_msgs.command_parser import BAD_INPUT, one_line
from worm_msgs.parameter_rows import ParameterRow
from worm_msgs.ros_parameter_file import matches, read_sections
from worm_msgs.ros_process import own_arguments, ros_process
from worm_msgs.yaml_file import SettingsFileError

#: Prefixes of parameter names that are accepted although the node does not declare them, because rclpy reads them.
_ALLOWED = ("qos_overrides.",)
_FILE_OPTION = "--params-file"

Rows = Callable[[], Sequence[ParameterRow]]


class ParameterRejectedError(ValueError):
    """A parameter cannot be used. The message is one line."""


def declare(node: Node, rows: Rows) -> None:
    """Declare the parameters of a node.

    A parameter of type float accepts an integer, also later. Setting a parameter to its present value succeeds, also if
    it is read-only.

    Args:
        node: the node.
        rows: returns the descriptions of the parameters.

    Raises:
        ParameterRejectedError: A value has the wrong type or is out of range, a name is unknown, or a parameter file
            has sections only for other nodes, one of them with a name that is similar to this node's and probably
            misspelt.
    """
    _check_files(node)
    table = rows()
    floats = frozenset(row.name for row in table if _is_float(row.default))
    # Only this private mapping of rclpy contains the parameters of the command line and of the parameter files.
    overrides: dict[str, Parameter] = node._parameter_overrides
    overrides.update({name: _converted(p, floats) for name, p in overrides.items()})
    for row in table:
        try:
            node.declare_parameter(row.name, row.default, row.descriptor())
        except ParameterException as error:
            raise ParameterRejectedError(f"parameter {row.name}: {one_line(error)}") from error
    _reject_unknown(node, overrides)
    _set_changes_alone(node, floats)


def _set_changes_alone(node: Node, floats: frozenset[str]) -> None:
    """Wrap the setter of a node so that a request to set parameters sets only those whose values change.

    rclpy rejects a read-only parameter even if its value stays the same, so `ros2 param load` of a node's own dump
    would fail. A callback cannot remove a parameter from a request, so this function wraps the method that all setters
    call.
    """
    set_all = node._set_parameters_atomically

    def set_changes(parameters: list[Parameter]) -> SetParametersResult:
        converted = [_converted(p, floats) for p in parameters]
        changes = [p for p in converted if not _is_set(node, p)]
        return set_all(changes) if changes else SetParametersResult(successful=True)

    node._set_parameters_atomically = set_changes


def _is_set(node: Node, parameter: Parameter) -> bool:
    """Return True if the node's parameter of this name already has this type and value. NaN equals NaN."""
    if not node.has_parameter(parameter.name):
        return False
    present = node.get_parameter_or(parameter.name, Parameter(parameter.name))
    return present.type_ == parameter.type_ and _text(present) == _text(parameter)


def _text(parameter: Parameter) -> str:
    value = parameter.value
    return repr(value.tolist() if isinstance(value, array) else value)


def _reject_unknown(node: Node, overrides: dict[str, Parameter]) -> None:
    for name in overrides:
        if node.has_parameter(name) or name.startswith(_ALLOWED):
            continue
        known = sorted(node.get_parameters_by_prefix(""))
        near = difflib.get_close_matches(name, known, n=1)
        hint = f"did you mean {near[0]}?" if near else f"the parameters are {', '.join(known)}"
        raise ParameterRejectedError(f"no parameter {name}: {hint}")


def declare_none(node: Node) -> None:
    """Reject all given parameters that rclpy does not declare, for a node without parameters of its own."""
    try:
        declare(node, list)
    except ParameterRejectedError as error:
        print(f"{node.get_name()}: {one_line(error)}", file=sys.stderr)  # noqa: T201 (output of a command)
        raise SystemExit(BAD_INPUT) from error


def _check_files(node: Node) -> None:
    """Check that the parameter files are for this node, because rcl silently ignores sections with other names.

    A file that has sections only for other nodes causes a warning. It causes an error if the name of one of these
    sections is similar to this node's, because the name is then probably misspelt.
    """
    name = node.get_fully_qualified_name()
    files = (file for option, file in pairwise(sys.argv) if option == _FILE_OPTION)
    for file in files:
        try:
            names = [known for known, _ in read_sections(file)]
        except SettingsFileError as error:
            raise ParameterRejectedError(str(error)) from None
        if not names or any(matches(known, name) for known in names):
            continue
        own = name.rsplit("/", 1)[-1]
        last = {known.rsplit("/", 1)[-1]: known for known in names}
        near = difflib.get_close_matches(own, last, n=1)
        if near:
            raise ParameterRejectedError(
                f"{file} is for {last[near[0]]}; the name of this node is {name}, so ROS would ignore the "
                "file: use that of this robot, or /** for all nodes"
            )
        node.get_logger().warning(
            f"{file} contains no parameters of {name}, only of {', '.join(names)}"
        )


def _is_float(default: Any) -> bool:
    return isinstance(default[0] if isinstance(default, list) and default else default, float)


def _converted(parameter: Parameter, floats: frozenset[str]) -> Parameter:
    """Return a parameter, with a float in place of an integer if its name is in ``floats``.

    A node's own dump has ``.nan``, which rcl reads as a text.
    """
    if parameter.name not in floats:
        return parameter
    value = parameter.value
    if parameter.type_ is Parameter.Type.INTEGER:
        return Parameter(parameter.name, value=float(value))
    if parameter.type_ is Parameter.Type.STRING and value.lower() == ".nan":
        return Parameter(parameter.name, value=math.nan)
    if parameter.type_ is Parameter.Type.INTEGER_ARRAY:
        return Parameter(parameter.name, value=[float(each) for each in value])
    return parameter


def run_node(parser: argparse.ArgumentParser, module: ModuleType, command_line: list[str]) -> int:
    """Parse the command line and run a node. On bad input, print one line on standard error; the exit status is 2.

    Args:
        parser: parser of the arguments that are not ROS arguments.
        module: its function ``run`` creates and serves the node, and returns the exit status (None means 0). It is
            called with a function that returns True once a signal requests the end. Its tuple ``REJECTIONS`` has the
            exceptions that ``run`` raises on bad input.
        command_line: command line with the program's name.

    Returns:
        Exit status.
    """
    rejected: tuple[type[Exception], ...] = (ParameterRejectedError, *module.REJECTIONS)
    parser.parse_args(own_arguments(command_line)[1:])
    try:
        with ros_process(command_line) as ended:
            return module.run(ended) or 0
    except rejected as error:
        print(f"{parser.prog}: {one_line(error)}", file=sys.stderr)  # noqa: T201 (output of a command)
        return BAD_INPUT
