# SPDX-License-Identifier: Apache-2.0
"""A robot from the first process to the last: nodes, activation, gaits, release. Used by all that bring one up."""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from ament_index_python.packages import get_package_share_directory

from worm_model.analysis.run_metrics import RecordingError
from worm_optimizer.nodes.operator_node import (
    GaitFailedError,
    OperatorError,
    OperatorNode,
    operator,
)
from worm_optimizer.operation.processes import ProcessError, ProcessGroup, executable_command
from worm_optimizer.operation.system import NodeDescription, System, SystemFile, load_system_file
from worm_optimizer.orders import Order, RunProgress, RunResult

READY_TIMEOUT_S = 120.0  # of a node on a busy computer
CYCLES = 5
AFTERWARDS_S = 2.0  # of rest that end a recording; the slack of a resting cable comes back in it
RECORDER = "recorder"  # name of the node in system.yaml
BUSY = 1.5  # load average per processor from where it may be the cause of a failure
_TO_REST = (
    "--to-rest"  # of a recorder of all nodes, to end when the robot is let go; a run's ends with it
)
_EXCLUDE = "--exclude"
FAILURES = (ProcessError, OperatorError, RecordingError)

Say = Callable[[str], None]
#: called while waiting; raises where what is waited for is to be given up
Check = Callable[[], None]


class ProgressLog:
    """Tells on standard error what goes on, and since when."""

    def __init__(self, program: str) -> None:
        self._program = program
        self._start = time.monotonic()

    def __call__(self, text: str) -> None:
        """Tell one line."""
        elapsed = time.monotonic() - self._start
        print(f"{self._program}: {elapsed:5.1f} s  {text}", file=sys.stderr, flush=True)  # noqa: T201


@contextmanager
def work_folder(program: str) -> Iterator[Path]:
    """A folder for sockets, with a folder ``logs`` in it, which stays only after a failure."""
    folder = Path(tempfile.mkdtemp(prefix=f"worm_{program}_"))
    (folder / "logs").mkdir()
    try:
        yield folder
    except FAILURES:
        print(f"{program}: the logs of all nodes are in {folder / 'logs'}", file=sys.stderr)  # noqa: T201
        raise
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    shutil.rmtree(folder, ignore_errors=True)


def installed_system_file() -> SystemFile:
    """The system.yaml that is installed with this package."""
    share = Path(get_package_share_directory("worm_optimizer"))
    return load_system_file(share / "config" / "system.yaml")


@dataclass(frozen=True)
class Session:
    """Nodes that run, and the operator who works with them."""

    group: ProcessGroup
    node: OperatorNode
    system: System
    say: Say

    def activate(self) -> None:
        """Configure and activate the driver."""
        self.say("activating the driver")
        self.node.activate()

    def run_gait(self, order: Order) -> RunResult:
        """Runs a gait; one that fails is run once more, from rest, and that is said.

        Raises `OperatorError`, which names the load where that may be the cause.
        """
        try:
            return self.node.run(order, once_per_cycle(self.say, order))
        except GaitFailedError as error:
            self.say(f"{error}{load(self.node.late_cycles)}: once more")
            self.node.deactivate()
            self.node.activate()
        try:
            return self.node.run(order, once_per_cycle(self.say, order))
        except GaitFailedError as error:
            raise GaitFailedError(f"{error}, twice{load(self.node.late_cycles)}") from None

    def release(self) -> None:
        """Stop the robot, and take the torque off."""
        self.node.stop()
        self.node.deactivate()
        self.say("the robot has stopped, its torque is off")


@contextmanager
def session(
    system: System, logs: Path, say: Say, restarts: int = 0, check: Check = lambda: None
) -> Iterator[Session]:
    """The nodes of a system, started in their order; afterwards no process is left, whatever happened.

    Nothing is started where the robot has a driver already; who only looks on is welcome. A node that is not
    required and fails is started again so many times, and then missed.
    Raises `ProcessError` or `OperatorError` with the stage that failed.
    """
    with ProcessGroup(logs) as group:
        watch = _Watch(group, system, say, restarts) if restarts else group.check

        def look() -> None:
            watch()
            check()

        with operator(system.namespace, look) as node:
            node.refuse_second_driver()
            start_nodes(group, system, say)
            node.wait_for_nodes(description.name for description in system.nodes)
            yield Session(group, node, system, say)
        say("stopping the nodes")
    check_ends(group)


class _Watch:
    """Looks after processes that are to stay up: starts again what may fail, fails with what must not."""

    def __init__(self, group: ProcessGroup, system: System, say: Say, restarts: int) -> None:
        self._group = group
        self._say = say
        self._optional = {node.name: restarts for node in system.nodes if not node.required}

    def __call__(self) -> None:
        """Raises `ProcessError` where a node has ended that the others need."""
        for name in self._optional.keys() & self._group.processes.keys():
            process = self._group.processes[name]
            if process.exit_code is not None:
                self._restart(name, process.last_line())
        for name, process in self._group.processes.items():
            if process.exit_code is not None:
                raise ProcessError(f"{name} has ended: {process.last_line()}")

    def _restart(self, name: str, last_line: str) -> None:
        self._optional[name] -= 1
        if self._optional[name] < 0:
            self._group.forget(name)
            self._say(f"{name} has ended: {last_line}; the others run on without it")
        else:
            self._group.restart(name)
            self._say(f"{name} has ended: {last_line}; it starts again")


def start_nodes(group: ProcessGroup, system: System, say: Say) -> None:
    """Start the nodes in their order, waiting for those that say when they are ready."""
    for node in system.nodes:
        say(f"starting {node.name}: {node.package} {node.executable}")
        start_node(group, node, system.namespace, node.name)


def start_node(
    group: ProcessGroup, node: NodeDescription, namespace: str, process_name: str
) -> None:
    """Start one node and wait until it says that it is ready, if it does."""
    command = executable_command(node.package, node.executable)
    process = group.start(process_name, [*command, *node.command_arguments(namespace)])
    if node.ready:
        process.wait_for_line(node.ready, READY_TIMEOUT_S)


@contextmanager
def recording(
    group: ProcessGroup, node: OperatorNode, recorder: NodeDescription, name: str
) -> Iterator[None]:
    """A recorder of its own for what happens meanwhile, under a name that no other process and node has.

    It hears every topic before anything happens and some rest afterwards, when its bag is whole. Raises
    `ProcessError` or `OperatorError`.
    """
    words = tuple(word for word in recorder.arguments if word != _TO_REST)
    own = replace(recorder, name=name, arguments=words)
    start_node(group, own, node.get_namespace().strip("/"), name)
    node.wait_for_recorder(name, left_out(recorder))
    yield
    node.rest(AFTERWARDS_S)
    group.end(name)


def left_out(recorder: NodeDescription) -> str:
    """The regular expression of the topics that a recorder is told to leave out, empty where there is none."""
    words = recorder.arguments
    return words[words.index(_EXCLUDE) + 1] if _EXCLUDE in words else ""


def once_per_cycle(say: Say, order: Order) -> Callable[[RunProgress], None]:
    """A progress that tells each cycle once."""
    reported = {0}

    def progress(now: RunProgress) -> None:
        if now.cycle not in reported:
            reported.add(now.cycle)
            say(f"cycle {now.cycle} of {order.cycles}" if order.cycles else str(now))

    return progress


def load(late_cycles: int) -> str:
    """What is to be said of the computer beside a failure; empty where it was not busy and the driver not late."""
    average, processors = os.getloadavg()[0], os.cpu_count() or 1
    shares = []
    if average > BUSY * processors:
        shares.append(f"load average {average:.1f} on {processors} processors")
    if late_cycles:
        shares.append(f"{late_cycles} cycles of the driver late")
    return f" (the computer was busy: {', '.join(shares)})" if shares else ""


def check_ends(group: ProcessGroup) -> None:
    """Raise `ProcessError` if a process that has ended did not do so in order."""
    for process in group.processes.values():
        if process.exit_code != 0:
            raise ProcessError(
                f"{process.name} did not end in order (exit status {process.exit_code}): "
                f"{process.last_line()}"
            )
