# SPDX-License-Identifier: Apache-2.0
"""A robot from the first process to the last: nodes, activation, gaits, release. Used by all that bring one up."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from worm_model.gait import Gait
from worm_optimizer.nodes.operator_node import GaitFailedError, OperatorNode, operator
from worm_optimizer.operation.processes import ProcessError, ProcessGroup, executable_command
from worm_optimizer.operation.system import NodeDescription, System

READY_TIMEOUT_S = 120.0  # of a node on a busy computer
CYCLES = 5
DRIVER, RECORDER = "driver", "recorder"  # names of nodes in system.yaml
BUSY = 1.5  # load average per processor from where it may be the cause of a failure

Say = Callable[[str], None]


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
        self.node.activate(DRIVER)

    def run_gait(self, gait: Gait) -> None:
        """Runs five cycles; a gait that fails is run once more, from rest, and that is said.

        Raises `OperatorError`, which names the load where that may be the cause.
        """
        try:
            self.node.run_gait(gait, CYCLES, once_per_cycle(self.say))
        except GaitFailedError as error:
            self.say(f"{error}{load(self.node.late_cycles)}: once more")
            self.node.deactivate(DRIVER)
            self.node.activate(DRIVER)
        else:
            return
        try:
            self.node.run_gait(gait, CYCLES, once_per_cycle(self.say))
        except GaitFailedError as error:
            raise GaitFailedError(f"{error}, twice{load(self.node.late_cycles)}") from None

    def release(self) -> None:
        """Stop the robot, and take the torque off."""
        self.node.stop()
        self.node.deactivate(DRIVER)
        self.say("the robot has stopped, its torque is off")


@contextmanager
def session(system: System, logs: Path, say: Say) -> Iterator[Session]:
    """The nodes of a system, started in their order; afterwards no process is left, whatever happened.

    Raises `ProcessError` or `OperatorError` with the stage that failed.
    """
    with ProcessGroup(logs) as group:
        start_nodes(group, system, say)
        with operator(system.namespace, group.check) as node:
            node.wait_for_nodes(description.name for description in system.nodes)
            yield Session(group, node, system, say)
        say("stopping the nodes")
    check_ends(group)


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


def once_per_cycle(say: Say) -> Callable[[int], None]:
    """A progress of `OperatorNode.run_gait` that tells each cycle once."""
    told = {0}

    def progress(cycle: int) -> None:
        if cycle not in told:
            told.add(cycle)
            say(f"cycle {cycle} of {CYCLES}")

    return progress


def load(late_cycles: int) -> str:
    """What is to be said of the computer beside a failure; empty where it was not busy and the driver not late."""
    average, processors = os.getloadavg()[0], os.cpu_count() or 1
    found = []
    if average > BUSY * processors:
        found.append(f"load average {average:.1f} on {processors} processors")
    if late_cycles:
        found.append(f"{late_cycles} cycles of the driver late")
    return f" (the computer was busy: {', '.join(found)})" if found else ""


def check_ends(group: ProcessGroup) -> None:
    """Raise `ProcessError` if a process that has ended did not do so in order."""
    for process in group.processes.values():
        if process.exit_code != 0:
            raise ProcessError(
                f"{process.name} did not end in order (exit status {process.exit_code}): "
                f"{process.last_line()}"
            )
