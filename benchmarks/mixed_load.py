# SPDX-License-Identifier: Apache-2.0
"""Load of a robot computer during a measurement: other nodes, bursts of computation, and writes to a disk.

``python -m benchmarks.mixed_load burst`` and ``… write FOLDER`` run one part; `mixed_load` runs all of them.
"""

from __future__ import annotations

import contextlib
import os
import shlex
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from worm_optimizer.operation.processes import ProcessGroup, executable_command

DOMAINS = (91, 92)  # of the other demos
BURST_S, PAUSE_S = 0.3, 0.2
WRITTEN_BYTES = 50 * 2**20


def burst() -> None:
    """Alternate between computation and sleep."""
    while True:
        end = time.monotonic() + BURST_S
        while time.monotonic() < end:
            sum(range(1000))
        time.sleep(PAUSE_S)


def write(folder: Path) -> None:
    """Write a file repeatedly and synchronise it with the disk."""
    block = os.urandom(2**20)
    while True:
        with (folder / "written").open("wb") as file:
            for _ in range(WRITTEN_BYTES // len(block)):
                file.write(block)
            file.flush()
            os.fsync(file.fileno())


@contextlib.contextmanager
def mixed_load() -> Iterator[None]:
    """Run demos in two other ROS domains in turn, a loop with bursts, and a writer that synchronises."""
    with tempfile.TemporaryDirectory() as name, ProcessGroup(Path(name)) as group:
        part = [sys.executable, "-m", "benchmarks.mixed_load"]
        group.start("burst", [*part, "burst"])
        group.start("write", [*part, "write", name])
        demo = shlex.join([*executable_command("worm_optimizer", "demo"), "--bags", f"{name}/bags"])
        for domain in DOMAINS:
            # Not the shell's last command, or the shell would be the demo, and end with it.
            loop = f"export ROS_DOMAIN_ID={domain}; trap 'exit 0' INT; while :; do {demo} --seed {domain}; done"
            group.start(f"demo_{domain}", ["bash", "-c", loop])
        yield


if __name__ == "__main__":
    if sys.argv[1] == "burst":
        burst()
    write(Path(sys.argv[2]))
