# SPDX-License-Identifier: Apache-2.0
"""Options of the commands that start a node graph: settings of system.yaml."""

from __future__ import annotations

import argparse
from pathlib import Path

from worm_model.commands.command_line import InputError, Parser
from worm_msgs.conditions import CONDITION_ROWS
from worm_optimizer.operation.system import Robot, SystemFileError, installed_system_file


def add_robot(parser: Parser) -> None:
    """Add --set and the conditions in the pipe; see `robot_of`."""
    parser.add_conditions(None)
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="setting of system.yaml, such as port=/dev/ttyUSB0 or seed=2; may be repeated",
    )


def robot_of(options: argparse.Namespace, mode: str) -> Robot:
    """Return the robot of a mode with the settings of the options. Raises `InputError` if a setting is invalid."""
    settings = (
        {"parameter_file": str(Path(options.parameters).resolve())} if options.parameters else {}
    )
    for name in CONDITION_ROWS:
        if (value := getattr(options, name)) is not None:
            settings[name] = repr(value)
    for text in options.set:
        name, separator, value = text.partition("=")
        if not (name and separator):
            raise InputError(f"--set {text}: write NAME=VALUE")
        settings[name] = value
    try:
        robot = Robot(installed_system_file(), mode, settings)
        robot.system()
        robot.conditions  # noqa: B018 (raises InputError)
    except SystemFileError as error:
        raise InputError(str(error)) from None
    return robot
