# SPDX-License-Identifier: Apache-2.0
"""Facts about every executable with ROS:

how it is loaded, and how a node handles arguments and parameters that it lacks.
"""

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


@pytest.mark.parametrize("executable", sorted(NODES))
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


@pytest.mark.parametrize("command", sorted(COMMANDS))
def test_ctrl_c_while_a_command_loads_is_no_traceback(processes: Processes, command: str):
    process = processes.start_executable("worm_optimizer", command, *COMMANDS[command])
    assert wait_for(lambda: loads(process, "numpy"), TIMEOUT_S)
    process.signal(signal.SIGINT)
    assert process.wait(TIMEOUT_S) == -signal.SIGINT
    assert "Traceback" not in process.output()


@pytest.mark.parametrize("executable", ["virtual_robot", "record", "play", "watch"])
def test_a_node_without_parameters_rejects_them(
    processes: Processes, arguments: dict[str, list[str]], executable: str
):
    options = [*arguments.get(executable, []), "--ros-args", "-p", "frobnicate:=1"]
    process = processes.start_executable(NODES[executable], executable, *options)
    assert process.wait(TIMEOUT_S) == 2
    assert "no parameter frobnicate" in process.last_line()
    assert "Traceback" not in process.output()
