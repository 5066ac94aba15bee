# SPDX-License-Identifier: Apache-2.0
"""Sessions with a robot: start of its nodes, activation, gaits, recordings, and shutdown of the nodes."""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from worm_model.bags.formats.finding import METADATA_FILE, TIME_FIELD
from worm_model.errors import InputError, RecordingError
from worm_msgs.claim import domain_of, holder
from worm_optimizer.nodes.operator_node import (
    GaitFailedError,
    OperatorNode,
    RejectedStartError,
    operator,
)
from worm_optimizer.nodes.robot_client import OperatorError
from worm_optimizer.operation.processes import (
    Process,
    ProcessError,
    ProcessGroup,
    executable_command,
)
from worm_optimizer.operation.system import (
    DRIVER,
    RECORDER,
    NodeDescription,
    System,
)
from worm_optimizer.robot_commands import GaitCommand, RunProgress, RunResult

START_S = 120.0  # timeout for the start of a recorder, s; sufficient on a busy computer
CYCLES = 5  # default number of cycles of a run
AFTERWARDS_S = 2.0  # rest at the end of a recording, s, during which the cable becomes slack again
# Option of a recorder: after an interrupt, record until torque is released. `recorded` removes it, because its
# recorders end before the torque is released.
_TO_REST = "--to-rest"
FAILURES = (ProcessError, OperatorError, RecordingError)

Say = Callable[[str], None]
#: Called during waits; raises an exception to end the wait.
Check = Callable[[], None]


class ProgressLog:
    """Log of the progress on standard error. Each line contains the time since the creation of the log."""

    def __init__(self, program: str) -> None:
        self._program = program
        self._start = time.monotonic()

    def __call__(self, text: str) -> None:
        """Print one line."""
        elapsed = time.monotonic() - self._start
        print(f"{self._program}: {elapsed:5.1f} s  {text}", file=sys.stderr, flush=True)  # noqa: T201


@contextmanager
def work_folder(program: str) -> Iterator[Path]:
    """Provide a temporary folder that contains a folder ``logs``.

    The temporary folder is removed at the end of the context, unless one of `FAILURES` occurs.
    """
    folder = Path(tempfile.mkdtemp(prefix=f"worm_{program}_"))
    (folder / "logs").mkdir()
    with ExitStack() as removal:
        removal.callback(shutil.rmtree, folder, ignore_errors=True)
        try:
            yield folder
        except FAILURES:
            removal.pop_all()
            print(f"{program}: the logs of all nodes are in {folder / 'logs'}", file=sys.stderr)  # noqa: T201
            raise


@dataclass(frozen=True)
class Session:
    """Running nodes and an operator node.

    Attributes:
        group: processes of the nodes.
        node: the operator node, in the namespace of the system.
        say: called with each line of progress.
    """

    group: ProcessGroup
    node: OperatorNode
    say: Say

    def activate(self) -> None:
        """Configure and activate the driver."""
        self.say("activating the driver")
        self.node.activate()

    def run_gait(self, command: GaitCommand) -> RunResult:
        """Run a gait. If it fails, report the reason and run it once more, from rest."""
        try:
            return self.node.run(command, once_per_cycle(self.say))
        except GaitFailedError as error:
            self.say(f"{error}: once more")
        self.node.deactivate()
        self.node.activate()
        return self.node.run(command, once_per_cycle(self.say))

    def release(self) -> None:
        """Stop the robot and release its torque."""
        self.node.stop()
        self.node.deactivate()
        self.say("the robot has stopped, its torque is off")


@contextmanager
def session(
    system: System, logs: Path, say: Say, restarts: int = 0, check: Check = lambda: None
) -> Iterator[Session]:
    """Start the nodes of a system. When the context ends, also with an exception, end all processes.

    Args:
        system: the nodes.
        logs: folder of the log files.
        say: called with each line of progress.
        restarts: largest number of restarts of each optional node. A node that ends once more is not restarted, and the
            session continues without it. If ``restarts`` is 0, an error of any node ends the session.
        check: called during waits; raises an exception to end the session.

    Raises:
        ProcessError, OperatorError: A stage failed. The message contains the node or service, and the reason.
    """
    group = ProcessGroup(logs)
    optional = {node.name for node in system.nodes if not node.required} if restarts else set()
    left = dict.fromkeys(optional, restarts)

    def look() -> None:
        for name, process in list(group.processes.items()):
            if process.exit_code is None:
                continue
            report = process.report()
            if name not in left:
                raise ProcessError(report)
            left[name] -= 1
            if left[name] < 0:
                group.forget(name)
                say(f"{report}; the other nodes continue without it")
            else:
                group.restart(name)
                say(f"{report}; it starts again")
        check()

    try:
        with group, operator(system.namespace, look) as node:
            say(f"starting {', '.join(description.name for description in system.nodes)}")
            start_nodes(group, system)
            _wait_for_driver(group, node, system.namespace)
            node.wait_for_nodes(description.name for description in system.nodes)
            yield Session(group, node, say)
            say("stopping the nodes")
    finally:
        _report_torque(group, system)
    group.check()


def _wait_for_driver(group: ProcessGroup, node: OperatorNode, namespace: str) -> None:
    """Wait until the driver of this group is that of the namespace, so that no command reaches another robot."""
    own, domain = group.processes[DRIVER].pid, domain_of(os.environ)
    if not node.wait(lambda: holder(DRIVER, namespace, domain) == own, START_S):
        raise ProcessError(f"no driver in /{namespace} within {START_S:g} s")


def _report_torque(group: ProcessGroup, system: System) -> None:
    """Raise `ProcessError` if the driver has ended so that torque may be on."""
    driver = group.processes.get(DRIVER)
    if driver is not None and driver.exit_code and system.node(DRIVER).torque:
        raise ProcessError(system.node(DRIVER).end_report(driver.exit_code))


def start_nodes(group: ProcessGroup, system: System) -> None:
    """Start all nodes of a system."""
    for node in system.nodes:
        start_node(group, node, system.namespace)


def start_node(group: ProcessGroup, node: NodeDescription, namespace: str) -> Process:
    """Start a node."""
    command = executable_command(node.package, node.executable)
    return group.start(
        node.name, [*command, *node.command_arguments(namespace)], grace_s=node.end_timeout_s
    )


def bag_of(recorder: Process) -> Path:
    """Return the path of a recorder's bag. The recorder logs this path at its start."""
    return Path(recorder.wait_for_line(r": recording to (.+)$", START_S)[1])


def once_per_cycle(say: Say) -> Callable[[RunProgress], None]:
    """Return a callback that reports the progress of a run once per cycle, as one line."""
    reported: set[int] = set()

    def progress(now: RunProgress) -> None:
        if now.cycle not in reported:
            reported.add(now.cycle)
            say(str(now))

    return progress


def new_bag(folder: Path, kind: str = "run") -> Path:
    """Create a folder of bags, and return the path of a new bag in it. The recorder inserts the time into the path.

    Args:
        folder: folder of bags.
        kind: first part of the bag's name, followed by the time.
    """
    folder = folder.resolve()
    if (folder / METADATA_FILE).exists():
        raise InputError(f"{folder}: is a bag; give a folder that contains bags")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: {error.strerror}") from None
    return folder / f"{kind}_{TIME_FIELD}"


@contextmanager
def recorded(
    node: OperatorNode, recorder: NodeDescription, group: ProcessGroup | None = None
) -> Iterator[Path]:
    """Record during this context with a recorder of its own, and provide the path of the bag.

    The context begins when the recorder has subscribed to all topics. After the context, the recorder records for
    another `AFTERWARDS_S` and then closes the bag. If the driver rejects the gait, the bag is removed.

    Args:
        node: the operator.
        recorder: description of the recorder, see `Robot.recorder` and `system.recorder_of`.
        group: processes to which the recorder is added, and which are watched; None: a group of its own.
    """
    name = f"{RECORDER}_{os.getpid()}_{time.monotonic_ns()}"  # unique among all recorders
    words = tuple(word for word in recorder.arguments if word != _TO_REST)
    with ExitStack() as removal, ExitStack() as own_group:
        if group is None:
            work = own_group.enter_context(work_folder("record"))
            group = own_group.enter_context(ProcessGroup(work / "logs"))
        own = replace(recorder, name=name, arguments=words)
        bag = bag_of(start_node(group, own, node.get_namespace().strip("/")))
        node.wait_for_recorder(name)
        try:
            yield bag
        except (InputError, RejectedStartError):  # nothing moved
            removal.callback(shutil.rmtree, bag)  # when the recorder has ended
            group.end(name)
            raise
        node.rest(AFTERWARDS_S)
        group.end(name)
