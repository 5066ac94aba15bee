# SPDX-License-Identifier: Apache-2.0
"""Command line: the console, which shows and operates the robot in a browser."""

from __future__ import annotations

import argparse
import importlib.util
import os
import socket
import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from worm_model.commands.command_line import FAILED, InputError, Parser, executable, number
from worm_model.parameters import load_parameters
from worm_optimizer.commands.start import add_robot, robot_of
from worm_optimizer.nodes.operator_node import OperatorNode, operator
from worm_optimizer.operation.bring_up import Check, ProgressLog, Say, session, work_folder
from worm_optimizer.operation.processes import counted_interrupts
from worm_optimizer.operation.system import RESTARTS, System

PORT = 8080
CONTROL_TIMEOUT_S = 5.0  # default of --control-timeout
MAX_CONTROL_TIMEOUT_S = 600.0


def _parser() -> Parser:
    parser = Parser(
        prog="console",
        description="Show and operate the robot in a browser: live view, gaits, recordings. Connects to a "
        "running node graph (./worm start), or starts one with --virtual. Only browsers on this computer can open the "
        "page; from another one use ssh -L.",
    )
    parser.add_argument(
        "--virtual", action="store_true", help="start the node graph of a virtual robot"
    )
    parser.add_argument(
        "--namespace", default="worm", help="namespace of the robot (default: worm)"
    )
    parser.add_argument("--port", type=int, default=PORT, help=f"default: {PORT}")
    parser.add_argument(
        "--bags",
        type=Path,
        default=Path("bags"),
        metavar="FOLDER",
        help="folder of the recordings (default: bags)",
    )
    parser.add_argument(
        "--control-timeout",
        type=number,
        default=CONTROL_TIMEOUT_S,
        metavar="SECONDS",
        help="time without a message from a page after which the page loses control and its run ends, 2 to "
        f"{MAX_CONTROL_TIMEOUT_S:g} (default: {CONTROL_TIMEOUT_S:g})",
    )
    add_robot(parser)
    parser.add_parameters()
    return parser


def _console(options: argparse.Namespace) -> int:
    if importlib.util.find_spec("nicegui") is None:
        raise InputError(
            "the console needs NiceGUI: pip install --group console, or use ./worm console"
        )
    from worm_optimizer.console.bag_library import BagLibrary
    from worm_optimizer.console.console_page import HOST, serve
    from worm_optimizer.console.console_state import ConsoleState
    from worm_optimizer.console.control import PageControl
    from worm_optimizer.console.robot_worker import Notice, RobotWorker

    parameters = load_parameters(options.parameters)
    file = str(Path(options.parameters).resolve()) if options.parameters else ""
    _check_control_timeout(options.control_timeout)
    _reject_port_in_use(HOST, options.port)
    say = ProgressLog("console")
    notices: deque[Notice] = deque(maxlen=50)

    def notify(notice: Notice) -> None:
        notices.append(notice)
        say(notice.text)

    namespace = "/" + options.namespace.strip("/")
    name = f"console_{os.getpid()}"
    robot = robot_of(options, "virtual" if options.virtual else "robot")
    system = robot.system(namespace.strip("/"))
    worker = RobotWorker(
        partial(_started, system)
        if options.virtual
        else lambda _say, check: operator(namespace, check, name),
        lambda check: operator(namespace, check, f"{name}_stop"),
        notify,
    )
    control = PageControl(time.monotonic, options.control_timeout)
    library = BagLibrary(options.bags)
    state = ConsoleState(worker, control, library, parameters, file, notices)
    with counted_interrupts() as interrupts:
        say(f"http://{HOST}:{options.port}/ (Ctrl-C ends it)")
        try:
            serve(state, options.port, interrupts)
        finally:
            if worker.busy:
                say("waiting for the end of the run; another Ctrl-C holds the robot immediately")
            worker.close(hold_now=lambda: interrupts() > 1)
    return FAILED if worker.failure else 0


@contextmanager
def _started(system: System, say: Say, check: Check) -> Iterator[OperatorNode]:
    """Start the node graph of a virtual robot, activate its driver, and provide an operator node."""
    with (
        work_folder("console") as work,
        session(system, work / "logs", say, RESTARTS, check) as running,
    ):
        running.node.activate()
        say("all nodes run")
        yield running.node


def _check_control_timeout(timeout_s: float) -> None:
    """Raise `InputError` if the timeout is too long for a person to wait, or too short for a slow network."""
    if not 2.0 <= timeout_s <= MAX_CONTROL_TIMEOUT_S:
        raise InputError(
            f"--control-timeout {timeout_s:g}: give 2 to {MAX_CONTROL_TIMEOUT_S:g} seconds"
        )


def _reject_port_in_use(host: str, port: int) -> None:
    """Raise `InputError` if the port is unavailable."""
    try:
        with socket.socket() as tried:
            tried.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            tried.bind((host, port))
    except (OSError, OverflowError) as error:
        raise InputError(f"--port {port}: {error}") from None


main = executable(_parser, _console)
