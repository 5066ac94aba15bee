# SPDX-License-Identifier: Apache-2.0
"""Ctrl-C while an executable with ROS is loaded."""

import signal
from pathlib import Path

import pytest
from harness import TIMEOUT_S, Processes
from recorded_run import simulated_run, write_bag

from worm_optimizer.operation.processes import Process, wait_for

NODES = {
    "driver_node": "worm_driver",
    "virtual_robot": "worm_driver",
    "tracker_node": "worm_driver",
    "twin_node": "worm_model",
    "record": "worm_model",
    "play": "worm_model",
    "watch": "worm_model",
    "optimizer_node": "worm_optimizer",
}


COMMANDS = {
    "demo": [],
    "start": ["--virtual"],
    "operate": ["state"],
    "campaign": ["--help"],
    "console": ["--help"],
}


def loads(process: Process, library: str) -> bool:
    """Return True if a process has begun to load a library."""
    try:
        return library in Path(f"/proc/{process.pid}/maps").read_text()
    except OSError:
        return False


@pytest.fixture
def arguments(tmp_path: Path) -> dict[str, list[str]]:
    """Return the arguments that an executable requires."""
    return {
        "virtual_robot": ["--directory", str(tmp_path / "robot")],
        "record": ["--all", "--output", str(tmp_path / "bag")],
        "play": [str(write_bag(tmp_path / "played", simulated_run(cycles=1)))],
    }


def by_day(names: dict[str, object], *chosen: str) -> list[object]:
    """Return all names as parameters, those that are not chosen for the night."""
    return [
        name if name in chosen else pytest.param(name, marks=pytest.mark.night)
        for name in sorted(names)
    ]


@pytest.mark.parametrize("executable", by_day(NODES, "driver_node", "record"))
def test_ctrl_c_while_it_loads_is_no_traceback(
    processes: Processes, arguments: dict[str, list[str]], executable: str
):
    process = processes.start_executable(
        NODES[executable], executable, *arguments.get(executable, [])
    )
    assert wait_for(lambda: loads(process, "rclpy"), TIMEOUT_S)
    process.signal(signal.SIGINT)
    assert process.wait(TIMEOUT_S) in (0, -signal.SIGINT)
    assert "Traceback" not in process.output()


@pytest.mark.parametrize("command", by_day(COMMANDS, "start"))
def test_ctrl_c_while_a_command_loads_is_no_traceback(processes: Processes, command: str):
    process = processes.start_executable("worm_optimizer", command, *COMMANDS[command])
    assert wait_for(lambda: loads(process, "numpy"), TIMEOUT_S)
    process.signal(signal.SIGINT)
    assert process.wait(TIMEOUT_S) == -signal.SIGINT
    assert "Traceback" not in process.output()
