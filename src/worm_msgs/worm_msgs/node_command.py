# SPDX-License-Identifier: Apache-2.0
"""The executable of a node: its command line, and what it does with parameters that it is given.

Help or one line with status 2: nothing that was meant for a node is ignored, as the values of a robot
that is not there would run the one that is.
"""

from __future__ import annotations

import argparse
import difflib
import re
import sys
from array import array
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, NoReturn

import yaml
from rcl_interfaces.msg import SetParametersResult
from rclpy.exceptions import ParameterException
from rclpy.node import Node
from rclpy.parameter import Parameter

from worm_msgs.parameter_rows import ParameterRow, present_names
from worm_msgs.ros_process import ShutdownRequest, own_arguments, ros_process

BAD_INPUT = 2
#: what rclpy itself takes, beside the parameters that it declares
_ALLOWED = ("qos_overrides.",)
_FILE_OPTION = "--params-file"
_CONTENT = "ros__parameters"  # in such a file

Rows = Callable[[], Sequence[ParameterRow]]


class ParameterRejectedError(ValueError):
    """A parameter that was given cannot be used; the message is one line that says why."""


def declare(node: Node, rows: Rows) -> None:
    """Declare the parameters of a node.

    A whole number is a value of a float, too. A former name is accepted with a warning. All of that holds for
    parameters that are set later, too; setting one to the value that it has succeeds.

    Raises:
        ParameterRejectedError: a value has a wrong type or is out of its range, no row has its name, a parameter is
            given by both its names, or a file is for a node whose name is not this one's, but nearly.
    """
    _check_files(node)
    table = rows()
    floats = frozenset(row.name for row in table if _is_float(row.default))
    # rclpy keeps what the command line gave in this mapping alone
    overrides: dict[str, Parameter] = node._parameter_overrides
    given = list(overrides.values())
    overrides.clear()
    overrides.update({p.name: p for p in _translated(node, floats, given)})
    for row in table:
        try:
            node.declare_parameter(row.name, row.default, row.descriptor())
        except ParameterException as error:
            raise ParameterRejectedError(f"parameter {row.name}: {_one_line(error)}") from error
    _reject_unknown(node, overrides)
    _set_changes_alone(node, floats)


def _translated(
    node: Node, floats: frozenset[str], parameters: Sequence[Parameter]
) -> list[Parameter]:
    """Return parameters by their present names, whole numbers of ``floats`` as floats."""
    try:
        named = present_names({p.name: p for p in parameters}, node.get_logger().warning)
    except ValueError as error:
        raise ParameterRejectedError(str(error)) from error
    renamed = [p if p.name == name else _named(name, p) for name, p in named.items()]
    return [_as_float(p) if p.name in floats else p for p in renamed]


def _set_changes_alone(node: Node, floats: frozenset[str]) -> None:
    """Let requests to set parameters pass without those that change nothing.

    rclpy rejects a read-only parameter even where its value stays, so `ros2 param load` of a node's own dump would
    fail. Its callbacks cannot leave such a parameter out, hence the method below all its setters is wrapped.
    """
    set_all = node._set_parameters_atomically

    def set_changes(parameters: list[Parameter]) -> SetParametersResult:
        try:
            translated = _translated(node, floats, parameters)
        except ParameterRejectedError as error:
            return SetParametersResult(successful=False, reason=str(error))
        changes = [p for p in translated if not _is_set(node, p)]
        return set_all(changes) if changes else SetParametersResult(successful=True)

    node._set_parameters_atomically = set_changes


def _is_set(node: Node, parameter: Parameter) -> bool:
    """Return whether a parameter has this value already; NaN equals NaN."""
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
        hint = f"did you mean {near[0]}?" if near else f"there are {', '.join(known)}"
        raise ParameterRejectedError(f"no parameter {name}: {hint}")


def declare_none(node: Node) -> None:
    """As declare, of a node that has no parameters of its own.

    Raises:
        SystemExit: something was given that it has no use for; the reason is on standard error.
    """
    try:
        declare(node, list)
    except ParameterRejectedError as error:
        print(f"{node.get_name()}: {_one_line(error)}", file=sys.stderr)  # noqa: T201 (the command's own words)
        raise SystemExit(BAD_INPUT) from error


def _check_files(node: Node) -> None:
    """Rcl passes over what a file of parameters holds for other names than the node's without a word."""
    name = node.get_fully_qualified_name()
    files = (file for option, file in pairwise(sys.argv) if option == _FILE_OPTION)
    for file in files:
        names = list(_node_names(yaml.safe_load(Path(file).read_text(encoding="utf-8"))))
        if not names or any(re.fullmatch(_pattern(known), name) for known in names):
            continue
        own = name.rsplit("/", 1)[-1]
        last = {known.rsplit("/", 1)[-1]: known for known in names}
        near = difflib.get_close_matches(own, last, n=1)
        if near:
            raise ParameterRejectedError(f"{file} is for {last[near[0]]}, and this is {name}")
        node.get_logger().warning(f"{file} holds nothing for {name}, only for {', '.join(names)}")


def _node_names(content: Any, prefix: str = "") -> Iterator[str]:
    """Full names, wildcards included, of the nodes in a file of parameters."""
    for key, value in content.items() if isinstance(content, Mapping) else ():
        name = f"{prefix}/{str(key).strip('/')}"
        if key != _CONTENT and isinstance(value, Mapping):
            if _CONTENT in value:
                yield name
            yield from _node_names(value, name)


def _pattern(name: str) -> str:
    """A name with rcl's wildcards as a regular expression: * is one part of a name, ** any number of them."""
    parts = name.split("/")[1:]
    return "".join(
        "(/[^/]+)*" if part == "**" else "/" + re.escape(part).replace(r"\*", "[^/]+")
        for part in parts
    )


def _is_float(default: Any) -> bool:
    return isinstance(default[0] if isinstance(default, list) and default else default, float)


def _named(name: str, parameter: Parameter) -> Parameter:
    return Parameter(name, parameter.type_, parameter.value)


def _as_float(parameter: Parameter) -> Parameter:
    value = parameter.value
    if parameter.type_ is Parameter.Type.INTEGER:
        return Parameter(parameter.name, value=float(value))
    if parameter.type_ is Parameter.Type.INTEGER_ARRAY:
        return Parameter(parameter.name, value=[float(each) for each in value])
    return parameter


def run_node(
    name: str,
    description: str,
    rows: Rows,
    run: Callable[[ShutdownRequest], int | None],
    refusals: tuple[type[Exception], ...],
    arguments: Sequence[str] | None = None,
) -> int:
    """Parses the command line, runs a node, and turns what is refused into a line and status 2.

    Args:
        name: of the executable.
        description: for its help.
        rows: its parameters, for its help.
        run: makes the node and serves it; returns the exit status, None: 0.
        refusals: what else it raises on bad input.
        arguments: the command line with the program's name; None for that of the process.
    """
    refused: tuple[type[Exception], ...] = (ParameterRejectedError, *refusals)
    words = list(sys.argv if arguments is None else arguments)
    _Parser(name, description, rows).parse_args(own_arguments(words)[1:])
    try:
        with ros_process(words) as ended:
            return run(ended) or 0
    except refused as error:
        print(f"{name}: {_one_line(error)}", file=sys.stderr)  # noqa: T201 (the command's own words)
        return BAD_INPUT


class _Parser(argparse.ArgumentParser):
    """Knows --help alone: a node takes ROS arguments only."""

    def __init__(self, name: str, description: str, rows: Rows) -> None:
        table = "\n".join(
            f"  {row.name}  (default {row.default!r})\n      {row.description}" for row in rows()
        )
        super().__init__(
            prog=name,
            description=description,
            usage=f"{name} [--help] [--ros-args [-p PARAMETER:=VALUE] [--params-file FILE] [-r FROM:=TO] ...]",
            epilog=f"parameters:\n{table}",
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )

    def error(self, message: str) -> NoReturn:
        self.exit(BAD_INPUT, f"{self.prog}: {message}; see {self.prog} --help\n")


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())
