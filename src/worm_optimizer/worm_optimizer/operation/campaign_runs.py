# SPDX-License-Identifier: Apache-2.0
"""The part of the campaign with a robot in it: each gait from rest, recorded into a bag of its own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from worm_model.gait import Gait
from worm_optimizer.nodes.operator_node import OperatorNode, operator
from worm_optimizer.operation.demo_run import (
    CYCLES,
    DRIVER,
    RECORDER,
    Say,
    check_ends,
    once_per_cycle,
    start_node,
    start_nodes,
)
from worm_optimizer.operation.processes import ProcessGroup
from worm_optimizer.operation.system import System, SystemFile

_UNUSED = {"optimizer", RECORDER}  # the front is known; each gait has a recorder of its own
_AFTERWARDS_S = 2.0  # of rest that end a recording; the slack of a resting cable comes back in it
_TRACKER = "tracker"
_NO_TRACKER = "start the node of the camera in the robot's namespace, or no speed can be measured"


@dataclass(frozen=True)
class Robot:
    """Which robot: a ``mode`` of the system file, ``robot`` or ``virtual``, and settings other than its defaults."""

    file: SystemFile
    mode: str
    settings: Mapping[str, str]

    def system(self) -> System:
        """All nodes that run through the whole campaign."""
        whole = self.file.system(self.mode, **self.settings)
        return System(
            whole.namespace, tuple(node for node in whole.nodes if node.name not in _UNUSED)
        )

    def in_folder(self, folder: Path) -> Robot:
        """The same, its sockets in a folder, unless a setting says where."""
        return replace(self, settings={"directory": str(folder), **self.settings})

    def recording_system(self, bag: Path) -> System:
        """The same robot as a system that has a recorder, for one bag."""
        return self.file.system(self.mode, **{**self.settings, "bag": str(bag)})


def run_gaits(robot: Robot, gaits: Mapping[str, Gait], folder: Path, logs: Path, say: Say) -> None:
    """Runs five cycles of each gait and records it as ``folder/NAME``; then the robot is at rest and released.

    No process is left, whatever happens. Raises `ProcessError` or `OperatorError` with the stage that failed.
    """
    system = robot.system()
    with ProcessGroup(logs) as group:
        start_nodes(group, system, say)
        with operator(system.namespace, group.check) as node:
            node.wait_for_nodes(description.name for description in system.nodes)
            node.wait_for_publisher(_TRACKER, _NO_TRACKER)
            say("activating the driver")
            node.activate(DRIVER)
            for name, gait in gaits.items():
                _record_gait(group, node, robot.recording_system(folder / name), name, gait, say)
            node.stop()
            node.deactivate(DRIVER)
            say("the robot has stopped, its torque is off")
        say("stopping the nodes")
    check_ends(group)


def _record_gait(
    group: ProcessGroup, node: OperatorNode, system: System, name: str, gait: Gait, say: Say
) -> None:
    say(
        f"{name}: stroke {1e3 * gait.stroke:.1f} mm, frequency {gait.frequency:.3f} Hz, "
        f"{CYCLES} cycles in {CYCLES / gait.frequency:.0f} s"
    )
    process = f"{RECORDER}_{name}"
    start_node(group, system.node(RECORDER), system.namespace, process)
    node.wait_for_recorder(RECORDER)
    node.run_gait(gait, CYCLES, once_per_cycle(say))
    node.rest(_AFTERWARDS_S)
    group.end(process)
