# SPDX-License-Identifier: Apache-2.0
"""Ctrl-C while an executable with ROS is loaded."""

import signal
from pathlib import Path

import pytest
from harness import TIMEOUT_S, Processes

from worm_optimizer.operation.processes import Process, wait_for


def loads(process: Process, library: str) -> bool:
    """Return True if a process has begun to load a library."""
    try:
        return library in Path(f"/proc/{process.pid}/maps").read_text()
    except OSError:
        return False


@pytest.mark.parametrize(
    ("package", "executable", "arguments", "library"),
    [
        ("worm_driver", "driver_node", [], "rclpy"),
        ("worm_model", "record", ["--output", "{}/bag"], "rclpy"),
        ("worm_optimizer", "start", ["--virtual"], "numpy"),
    ],
)
def test_ctrl_c_while_it_loads_is_no_traceback(
    processes: Processes,
    tmp_path: Path,
    package: str,
    executable: str,
    arguments: list[str],
    library: str,
):
    words = [word.format(tmp_path) for word in arguments]
    process = processes.start_executable(package, executable, *words)
    assert wait_for(lambda: loads(process, library), TIMEOUT_S)
    process.signal(signal.SIGINT)
    assert process.wait(TIMEOUT_S) in (0, -signal.SIGINT)
    assert "Traceback" not in process.output()
