# SPDX-License-Identifier: Apache-2.0
"""Records the sample bags of this folder with the virtual robot: ``python bags/make.py FOLDER [NAME ...]``.

Each sample is a run of real processes: virtual robot, driver, recorder. Nothing is overwritten: choose a new folder,
look at what came out, and put it in the place of the old one. Runs in real time differ in their noise.
"""

from __future__ import annotations

import os
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

from worm_model.gait import FORWARD, REVERSE, Gait
from worm_optimizer.nodes.operator_node import OperatorNode, operator
from worm_optimizer.operation.processes import Process, ProcessGroup, executable_command
from worm_optimizer.robot_commands import GaitCommand, RunProgress

TIMEOUT_S = 60.0
BEFORE_S, AFTER_S = 2.0, 0.5  # recorded at rest, and after the gait's end
ROS = ("--ros-args", "-r", "__ns:=/worm")


@dataclass(frozen=True)
class Sample:
    """How a bag is made; `killed_in` is the cycle in which the recorder dies, 0 if it does not."""

    gait: Gait
    cycles: int
    seed: int
    arguments: tuple[str, ...] = ()
    killed_in: int = 0


SAMPLES = {
    "forward": Sample(Gait(0.07, 0.25, FORWARD), cycles=4, seed=1),
    "reverse": Sample(Gait(0.06, 0.30, REVERSE), cycles=3, seed=2),
    "faults": Sample(
        Gait(0.08, 0.25, FORWARD),
        cycles=2,
        seed=3,
        arguments=(
            "--fault",
            "ina219_reset@9",
            "--fault",
            "i2c_nack:count=3@11",
            "--fault",
            "corrupted_crc:count=2@12",
        ),
    ),
    "killed": Sample(Gait(0.07, 0.30, FORWARD), cycles=2, seed=4, killed_in=2),
}


def make(name: str, sample: Sample, folder: Path) -> None:
    """Record one sample into a new folder below `folder`."""
    with tempfile.TemporaryDirectory() as place, ProcessGroup(Path(place)) as group:
        _start_robot(group, sample, Path(place))
        record = [*executable_command("worm_model", "record"), "--output", str(folder / name)]
        record += ["--seed", str(sample.seed)]
        record += ["--note", f"made_by=bags/make.py {name}", *ROS]
        recorder = group.start("recorder", record)
        recorder.wait_for_line("recording to", TIMEOUT_S)
        with operator("/worm", group.check) as node:
            node.activate()
            node.graph.wait_for_recorder("recorder")
            node.rest(BEFORE_S)
            if sample.killed_in:
                _run_until_killed(node, sample, recorder)
            else:
                node.run(GaitCommand(sample.gait, sample.cycles), lambda _: None)
                node.rest(AFTER_S)
                group.end("recorder")
            node.stop()


def _start_robot(group: ProcessGroup, sample: Sample, place: Path) -> None:
    doors = place / "robot"
    arguments = ["--directory", str(doors), "--seed", str(sample.seed), *sample.arguments]
    robot = [*executable_command("worm_driver", "virtual_robot"), *arguments, *ROS]
    group.start("robot", robot).wait_for_line("^ready", TIMEOUT_S)
    driver = [*executable_command("worm_driver", "driver_node"), *ROS]
    for parameter in (
        f"port:={doors / 'servo_bus'}",
        f"i2c_bus:={doors / 'i2c.sock'}",
        "home_at_start:=true",
        "bus_watchdog_s:=1.0",  # virtual servos wait for this computer's processors
        "limits.max_silence_s:=0.8",
        "limits.max_following_error_m:=0.06",
    ):
        driver += ["-p", parameter]
    group.start("driver", driver)


def _run_until_killed(node: OperatorNode, sample: Sample, recorder: Process) -> None:
    def kill(now: RunProgress) -> None:
        if now.cycle == sample.killed_in and recorder.exit_code is None:
            recorder.kill()

    def check() -> None:
        """The recorder's death is no accident."""

    node._check = check
    node.run(GaitCommand(sample.gait, sample.cycles), kill)


def main() -> int:
    """Make the samples that are named, or all."""
    if len(sys.argv) < 2:
        sys.stderr.write("usage: python bags/make.py FOLDER [NAME ...]\n")
        return 2
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    for name in sys.argv[2:] or SAMPLES:
        sys.stderr.write(f"{name} ...\n")
        make(name, SAMPLES[name], folder)
    return 0


if __name__ == "__main__":
    sys.exit(main())
