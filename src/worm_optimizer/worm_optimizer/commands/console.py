# SPDX-License-Identifier: Apache-2.0
"""Command line: the console, which shows and operates the robot in a browser."""

from __future__ import annotations

import argparse
import importlib.util
import os
import secrets
import socket
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path

from worm_model.commands.command_line import FAILED, InputError, Parser, executable, number
from worm_model.parameters import load_parameters
from worm_optimizer.commands.robot_options import add_robot, robot_of
from worm_optimizer.nodes.operator_node import OperatorNode, operator
from worm_optimizer.operation.bring_up import Check, ProgressLog, Say, session
from worm_optimizer.operation.processes import counted_interrupts
from worm_optimizer.operation.system import RESTARTS

PORT = 8080
CONTROL_TIMEOUT_S = 5.0  # default of --control-timeout
# Longest time (s) without a request for which the driver lets a client keep control
MAX_CONTROL_TIMEOUT_S = 600.0


def _parser() -> Parser:
    parser = Parser(
        prog="console",
        description="Show and operate the robot in a browser: live view, gaits, recordings, studies. Connects to a "
        "running node graph (./worm start), or starts one with --virtual. Without --listen, only this computer can "
        "access the page.",
    )
    parser.add_argument(
        "--virtual", action="store_true", help="start the node graph of a virtual robot"
    )
    parser.add_argument(
        "--namespace", default="worm", help="namespace of the robot (default: worm)"
    )
    parser.add_argument(
        "--listen",
        default="127.0.0.1",
        metavar="ADDRESS",
        help="address of this computer on which the console serves the page, 0.0.0.0 for all addresses (default: "
        "127.0.0.1). Access from other computers needs the printed token or the password",
    )
    parser.add_argument("--port", type=int, default=PORT, help=f"default: {PORT}")
    parser.add_argument(
        "--password-file",
        type=Path,
        metavar="FILE",
        help="file whose first line is the password, instead of a token",
    )
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
            "the console needs NiceGUI: pip install -r requirements-console.txt, or use ./worm console"
        )
    from worm_optimizer.console.access import Access
    from worm_optimizer.console.bag_library import BagLibrary
    from worm_optimizer.console.console_state import ConsoleState, new_notices
    from worm_optimizer.console.control import ConsoleControl
    from worm_optimizer.console.robot_worker import Notice, RobotWorker
    from worm_optimizer.console.server import serve

    parameters = load_parameters(options.parameters)
    file = str(Path(options.parameters).resolve()) if options.parameters else ""
    secret = _secret(options)
    _check_control_timeout(options.control_timeout)
    _reject_port_in_use(options.listen, options.port)
    say = ProgressLog("console")
    notices = new_notices()

    def notify(notice: Notice) -> None:
        notices.append(notice)
        say(notice.text)

    namespace = "/" + options.namespace.strip("/")
    name = f"console_{os.getpid()}"
    worker = RobotWorker(
        _robot_opener(options, namespace, name, say),
        lambda check: operator(namespace, check, f"{name}_stop"),
        notify,
    )
    host = f"{socket.gethostname()}:{options.port}"
    control = ConsoleControl(host, time.monotonic, worker.request_control, options.control_timeout)
    library = BagLibrary(options.bags)
    state = ConsoleState(worker, control, library, parameters, file, notices)
    address = f"http://{_address(options.listen)}:{options.port}/"
    token = f"?token={secret}" if secret and not options.password_file else ""
    with counted_interrupts() as interrupts:
        say(f"{address}{token} (Ctrl-C ends it)")
        try:
            access = Access(secret, time.monotonic)
            serve(state, access, options.listen, options.port, interrupts)
        finally:
            if worker.busy:
                say("waiting for the end of the run; another Ctrl-C holds the robot immediately")
            worker.close(hold_now=lambda: interrupts() > 1)
    return FAILED if worker.failure else 0


def _robot_opener(
    options: argparse.Namespace, namespace: str, name: str, note: Say
) -> Callable[[Say, Check], AbstractContextManager[OperatorNode]]:
    """Return a function that opens an operator node, and with --virtual starts the node graph first.

    Args:
        options: command line.
        namespace: the robot's namespace.
        name: name of the operator node that connects to a running graph.
        note: prints a line in the terminal.
    """
    robot = robot_of(options, "virtual" if options.virtual else "robot")
    system = robot.file.system(robot.mode, namespace.strip("/"), **robot.settings)

    @contextmanager
    def opened(say: Say, check: Check) -> Iterator[OperatorNode]:
        if options.virtual:
            logs = Path(tempfile.mkdtemp(prefix="worm_console_"))
            note(f"the logs of all nodes go to {logs}")
            with session(system, logs, say, RESTARTS, check) as running:
                running.node.configure()
                say("all nodes run")
                yield running.node
        else:
            with operator(namespace, check, name) as node:
                yield node

    return opened


def _secret(options: argparse.Namespace) -> str:
    """Return the token or password; empty if only this computer can access the pages. Raises `InputError`."""
    from worm_optimizer.console.access import is_local

    if options.password_file is None:
        return "" if is_local(options.listen) else secrets.token_urlsafe(24)
    try:
        password = options.password_file.read_text(encoding="utf-8").splitlines()[:1]
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"--password-file {options.password_file}: {error}") from None
    if not password or len(password[0]) < 8:
        raise InputError(
            f"--password-file {options.password_file}: the first line must have 8 characters or more"
        )
    return str(password[0])


def _check_control_timeout(timeout_s: float) -> None:
    """Raise `InputError` if the timeout is longer than the driver permits, or too short for a slow network."""
    if not 2.0 <= timeout_s <= MAX_CONTROL_TIMEOUT_S:
        raise InputError(
            f"--control-timeout {timeout_s:g}: give 2 to {MAX_CONTROL_TIMEOUT_S:g} seconds"
        )


def _address(host: str) -> str:
    """Return the host part of the page's URL. If the server listens on all addresses, this is `_own_address`."""
    if host in ("0.0.0.0", "::"):
        return _own_address()
    return f"[{host}]" if ":" in host else host


def _reject_port_in_use(host: str, port: int) -> None:
    """Raise `InputError` if the address or the port is unavailable."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        with socket.socket(family, socket.SOCK_STREAM) as tried:
            tried.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            tried.bind((host, port))
    except (OSError, OverflowError) as error:
        raise InputError(f"--listen {host} --port {port}: {error}") from None


def _own_address() -> str:
    """Return the IPv4 address of this computer in its network; without one, the name of the computer.

    Connecting a datagram socket selects the interface towards an address without sending anything. The address is
    reserved for documentation (RFC 5737).
    """
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.connect(("192.0.2.1", 9))
            return str(probe.getsockname()[0])
    except OSError:
        return socket.gethostname()


main = executable(_parser, _console)
