# SPDX-License-Identifier: Apache-2.0
"""What the commands that bring a robot up share: settings of system.yaml."""

from __future__ import annotations

import argparse
from pathlib import Path

from worm_model.commands.command_line import InputError, Parser
from worm_optimizer.operation.bring_up import installed_system_file
from worm_optimizer.operation.campaign_runs import Robot
from worm_optimizer.operation.system import SystemFileError


def add_robot(parser: Parser) -> None:
    """Adds --set; see `robot_of`."""
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="a setting of system.yaml, such as port=/dev/ttyUSB0 or seed=2; may be repeated",
    )


def robot_of(options: argparse.Namespace, mode: str) -> Robot:
    """The robot of a mode with the settings that are asked for; raises InputError if there is no such setting."""
    settings = (
        {"parameter_file": str(Path(options.parameters).resolve())} if options.parameters else {}
    )
    for text in options.set:
        name, separator, value = text.partition("=")
        if not (name and separator):
            raise InputError(f"--set {text}: write NAME=VALUE")
        settings[name] = value
    try:
        robot = Robot(installed_system_file(), mode, settings)
        robot.system()
    except SystemFileError as error:
        raise InputError(str(error)) from None
    return robot
