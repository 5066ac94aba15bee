# SPDX-License-Identifier: Apache-2.0
"""The part of the demo with a robot in it: from the first process to a closed recording."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from worm_optimizer.nodes.operator_node import OperatorNode, operator
from worm_optimizer.operation.processes import ProcessError, ProcessGroup, executable_command
from worm_optimizer.operation.system import NodeDescription, System
from worm_optimizer.robustness.prediction import Prediction

READY_TIMEOUT_S = 30.0
CYCLES = 5
DRIVER, RECORDER = "driver", "recorder"  # names of nodes in system.yaml
PATIENCE_S = 5.0  # between two lines that say that there is no gait yet

Say = Callable[[str], None]


def drive(system: System, logs: Path, say: Say) -> Prediction:
    """Bring a system up, request a gait, run five cycles of it, and bring everything to its end.

    The bag is whole afterwards, and no process is left, whatever happens. Returns what the
    optimizer predicted. Raises `ProcessError` or `OperatorError` with the stage that failed.
    """
    with ProcessGroup(logs) as group:
        start_nodes(group, system, say)
        with operator(system.namespace, group.check) as node:
            prediction = _run_gait(node, system, say)
        say("stopping the nodes")
    check_ends(group)
    return prediction


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


def _run_gait(node: OperatorNode, system: System, say: Say) -> Prediction:
    names = [description.name for description in system.nodes]
    node.wait_for_nodes(names)
    node.refuse_strangers(names)
    prediction = node.request_cruise(_now_and_then(say))
    gait = prediction.gait
    say(
        f"the optimizer answers: stroke {1e3 * gait.stroke:.1f} mm, frequency "
        f"{gait.frequency:.3f} Hz, margin {1e3 * gait.margin:.1f} mm"
    )
    say("activating the driver")
    node.activate(DRIVER)
    node.wait_for_recorder(RECORDER)
    say(f"running {CYCLES} cycles, {CYCLES / gait.frequency:.0f} s")
    node.run_gait(gait, CYCLES, once_per_cycle(say))
    node.stop()
    node.deactivate(DRIVER)
    say("the robot has stopped, its torque is off")
    return prediction


def _now_and_then(say: Say) -> Callable[[str], None]:
    last = [-PATIENCE_S]

    def progress(reason: str) -> None:
        if time.monotonic() > last[0] + PATIENCE_S:
            last[0] = time.monotonic()
            say(f"requesting a gait: {reason}")

    return progress


def once_per_cycle(say: Say) -> Callable[[int], None]:
    """A progress of `OperatorNode.run_gait` that tells each cycle once."""
    told = {0}

    def progress(cycle: int) -> None:
        if cycle not in told:
            told.add(cycle)
            say(f"cycle {cycle} of {CYCLES}")

    return progress


def check_ends(group: ProcessGroup) -> None:
    """Raise `ProcessError` if a process that has ended did not do so in order."""
    for process in group.processes.values():
        if process.exit_code != 0:
            raise ProcessError(
                f"{process.name} did not end in order (exit status {process.exit_code}): "
                f"{process.last_line()}"
            )
