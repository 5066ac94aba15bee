# SPDX-License-Identifier: Apache-2.0
"""Long sequence of gaits on the virtual robot as fast as the processes can: growth of memory, files and errors.

``WORM_BENCH_CYCLES=10000 ./worm bench soak`` runs ten thousand cycles.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray

from benchmarks.report import Row
from worm_model.gait import FORWARD, REVERSE, Gait
from worm_optimizer.nodes.operator_node import operator
from worm_optimizer.operation.bring_up import start_nodes
from worm_optimizer.operation.processes import ProcessGroup
from worm_optimizer.operation.system import System, load_system_file
from worm_optimizer.robot_commands import GaitCommand

TITLE = "soak: growth of memory and files, drift, over gaits faster than real time (WORM_BENCH_CYCLES for more)"
DOMAIN = 94
CYCLES = 200
CYCLES_PER_GAIT = 20
LEFT_OUT = {"optimizer"}
LATE = "missed_deadlines"
SYSTEM = Path(__file__).parents[1] / "src/worm_optimizer/config/system.yaml"


@dataclass(frozen=True)
class Sample:
    """Resident memory (MB), open files and threads of a process."""

    memory: float
    files: int
    threads: int

    @staticmethod
    def of(pid: int) -> Sample:
        """Return the present values of a process."""
        process = Path(f"/proc/{pid}")
        lines = (process / "status").read_text().splitlines()
        status = dict(line.split(":", 1) for line in lines)
        return Sample(
            int(status["VmRSS"].split()[0]) / 1024,
            len(list((process / "fd").iterdir())),
            int(status["Threads"]),
        )


def run() -> list[Row]:
    """Run gaits in alternating directions, each of some cycles."""
    os.environ["ROS_DOMAIN_ID"] = str(DOMAIN)
    cycles = int(os.environ.get("WORM_BENCH_CYCLES", CYCLES))
    gaits = max(2, cycles // CYCLES_PER_GAIT)
    with tempfile.TemporaryDirectory() as name, ProcessGroup(Path(name)) as group:
        whole = load_system_file(SYSTEM).system("virtual", directory=f"{name}/robot", rate="0")
        nodes = tuple(node for node in whole.nodes if node.name not in LEFT_OUT)
        start_nodes(group, System(whole.namespace, nodes))
        with operator(whole.namespace, group.check) as node:
            late: list[int] = []
            name = f"{whole.namespace}/driver: timing"

            def note(message: DiagnosticArray) -> None:
                timing = [status.values for status in message.status if status.name == name]
                late.extend(int(v.value) for row in timing for v in row if v.key == LATE)

            node.create_subscription(DiagnosticArray, "/diagnostics", note, 10)
            node.wait_for_nodes(each.name for each in nodes)
            node.activate()
            started = time.monotonic()
            samples, seconds = [], []
            for number in range(gaits):
                direction = FORWARD if number % 2 == 0 else REVERSE
                begun = node.robot_time_s
                node.run(GaitCommand(Gait(0.07, 0.4, direction), CYCLES_PER_GAIT), lambda _: None)
                seconds.append(node.robot_time_s - begun)
                samples.append({n: Sample.of(p.pid) for n, p in group.processes.items()})
                sys.stderr.write(
                    f"soak: {(number + 1) * CYCLES_PER_GAIT} cycles in {time.monotonic() - started:.0f} s\n"
                )
            elapsed = time.monotonic() - started
            node.stop()
            node.deactivate()
    return _rows(samples, seconds, late, elapsed)


def _rows(
    samples: list[dict[str, Sample]], seconds: list[float], late: list[int], elapsed: float
) -> list[Row]:
    done = len(samples) * CYCLES_PER_GAIT
    rows = [
        Row("cycles run", f"{done}", "", f"{sum(seconds) / elapsed:.1f} times real time"),
        Row("deadlines missed by the driver", f"{late[-1]}", "0", "in the robot's time"),
        Row(
            "time of a gait, last fifth over first",
            f"{_last_over_first(seconds):.4f}",
            "1",
            "by the robot's clock",
        ),
    ]
    for name in samples[0]:
        own = [sample[name] for sample in samples]
        settled = own[len(own) // 5]  # pools fill and code is compiled at first
        growth = own[-1].memory - settled.memory
        rows += [
            Row(f"{name}: memory", f"{growth:+.1f} MB", "no growth", f"of {own[-1].memory:.0f} MB"),
            Row(
                f"{name}: files, threads",
                f"{own[-1].files - settled.files:+d}, {own[-1].threads - settled.threads:+d}",
                "+0, +0",
                f"of {own[-1].files}, {own[-1].threads}",
            ),
        ]
    return rows


def _last_over_first(values: list[float]) -> float:
    fifth = max(1, len(values) // 5)
    return float(np.mean(values[-fifth:]) / np.mean(values[:fifth]))
