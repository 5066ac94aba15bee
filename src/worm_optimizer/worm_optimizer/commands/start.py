# SPDX-License-Identifier: Apache-2.0
"""Command line: the node graph of system.yaml until Ctrl-C, as an alternative to the launch file."""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

from worm_model.commands.command_line import FAILED, InputError, Parser, executable
from worm_msgs.conditions import CONDITION_ROWS
from worm_optimizer.nodes.robot_client import OperatorError
from worm_optimizer.operation.bring_up import FAILURES, ProgressLog, Session, session
from worm_optimizer.operation.processes import counted_interrupts, termination_as_interrupt
from worm_optimizer.operation.system import RESTARTS, Robot, installed_system_file


def _parser() -> Parser:
    parser = Parser(
        prog="start",
        description="Start the node graph and activate the driver. Ctrl-C brings the robot to rest and ends all nodes; "
        "a second one, more than 1.5 s later, releases the torque at once. "
        "If the driver cannot be activated, for example because it is not homed, print the reason and continue; "
        "`operate activate` then activates it.",
    )
    parser.add_argument(
        "--virtual", action="store_true", help="start a virtual robot instead of the real one"
    )
    parser.add_argument("--namespace", default="", help="namespace of all nodes (default: worm)")
    add_robot(parser)
    parser.add_parameters()
    return parser


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
    robot = Robot(installed_system_file(), mode, settings)
    robot.system()
    robot.conditions  # noqa: B018 (raises InputError)
    return robot


def _start(options: argparse.Namespace) -> int:
    robot = robot_of(options, "virtual" if options.virtual else "robot")
    system = robot.system(options.namespace)
    logs = Path(tempfile.mkdtemp(prefix="worm_start_"))
    say = ProgressLog("start")
    say(f"the logs of all nodes go to {logs}")
    try:
        with termination_as_interrupt(), session(system, logs, say, RESTARTS) as running:
            _keep(running, _activate(running))
    except FAILURES as error:
        print(f"start: the logs are in {logs}\nstart: {error}", file=sys.stderr)  # noqa: T201
        return FAILED
    return 0


def _activate(running: Session) -> str:
    """Activate the driver. Return the state and the next commands. If the activation fails, print the reason."""
    try:
        running.activate()
    except OperatorError as error:
        running.say(str(error))
        return (
            "ready, but not active: correct this, then ./worm operate home, ./worm operate activate"
        )
    return "ready: ./worm operate state, ./worm operate run --objective cruise"


def _keep(running: Session, state: str) -> None:
    """Print the state and run until a signal arrives. Raises `ProcessError` when a required node ends."""
    with counted_interrupts() as interrupts:
        running.say(f"{state}; Ctrl-C ends all")
        while not interrupts():
            running.node.wait(lambda: interrupts() > 0, 1.0)


main = executable(_parser, _start)
