# SPDX-License-Identifier: Apache-2.0
"""Command ``virtual_robot``: its arguments, and its end after bad input."""

import argparse
import math
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from worm_driver.virtual_robot.wire.faults import KINDS
from worm_msgs.claim import ClaimedError
from worm_msgs.command_parser import Parser, run_command
from worm_msgs.conditions import CONDITION_ROWS
from worm_msgs.ros_process import own_arguments, ros_process

# s, time slice of the interpreter's threads; with Python's default of 5 ms, answers on the bus would be too late.
_SWITCH_INTERVAL = 0.0002


def _parser() -> Parser:
    faults = "\n".join(f"  {name:18}{kind}" for name, kind in KINDS.items())
    parser = Parser(
        prog="virtual_robot",
        description="Simulate a worm robot: serve DIR/servo_bus (serial) and DIR/i2c.sock (power sensor).",
        epilog=f"faults, with their defaults:\n{faults}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "--directory",
        type=Path,
        required=True,
        metavar="DIR",
        help="folder of the ports; created if it is missing",
    )
    parser.add_argument(
        "--parameters",
        type=Path,
        metavar="FILE",
        help="parameter file of the virtual robot; default: the installed one",
    )
    parser.add_argument(
        "--seed", type=int, metavar="N", help="random seed; default: that of the parameter file"
    )
    for name, row in CONDITION_ROWS.items():
        parser.add_argument(
            row["option"],
            dest=name,
            type=float,
            metavar=row["unit"].upper().replace("/", "_PER_"),
            help=f"{row['meaning']}; default: that of the parameter file",
        )
    parser.add_argument(
        "--fault",
        action="append",
        default=[],
        metavar="NAME[:KEY=VALUE,…][@SECONDS]",
        help="inject a fault; keys: target (id of a servo), duration (s), count, value; may be repeated",
    )
    time = parser.add_mutually_exclusive_group()
    time.add_argument(
        "--rate",
        type=_rate,
        default=1.0,
        metavar="X",
        help="virtual seconds per second, at most; 0: as fast as possible (default 1). The virtual time waits for the "
        "driver, so results do not depend on the speed or the load of the machine",
    )
    time.add_argument(
        "--real-time",
        dest="rate",
        action="store_const",
        const=None,
        help="run in real time, like a real robot: to measure how well the driver meets its deadlines",
    )
    return parser


def _rate(text: str) -> float:
    value = float(text)
    if not (math.isfinite(value) and value >= 0.0):
        raise argparse.ArgumentTypeError(f"{text}: the rate must be a number, 0 or above")
    return value or math.inf


def _run(command_line: Sequence[str], options: argparse.Namespace) -> None:
    # Imported after --help, for which it would take too long.
    from worm_driver.nodes.virtual_robot_node import make_robot, run

    robot = make_robot(options)
    sys.setswitchinterval(_SWITCH_INTERVAL)
    with ros_process(command_line) as ended:
        run(robot, options, ended)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command and return the exit status."""
    command_line = sys.argv if arguments is None else ["virtual_robot", *arguments]
    return run_command(
        _parser(), partial(_run, command_line), own_arguments(command_line)[1:], (ClaimedError,)
    )
