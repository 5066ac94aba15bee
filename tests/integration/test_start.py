# SPDX-License-Identifier: Apache-2.0
"""The command start: the graph starts, accepts commands, rejects a second graph, and ends without traces."""

import json
import os
import signal
from pathlib import Path

import pytest
from harness import TIMEOUT_S, Processes

READY_S = 180.0  # the first front on a machine takes a minute

pytestmark = pytest.mark.timeout(400)


def test_start_keeps_the_graph_for_operate_rejects_a_second_one_and_ends_in_order(
    processes: Processes, tmp_path: Path
):
    place = ("--set", f"directory={tmp_path / 'robot'}")
    start = processes.start_executable("worm_optimizer", "start", "--virtual", *place)
    start.wait_for_line("ready: ", READY_S)
    state = processes.start_executable("worm_optimizer", "operate", "state", name="state")
    assert state.wait(TIMEOUT_S) == 0
    assert "active" in state.output()
    second = processes.start_executable(
        "worm_optimizer", "start", "--virtual", *place, name="second"
    )
    assert second.wait(2 * TIMEOUT_S) == 1
    assert f"/worm has a node graph already, process {start.pid} " in second.last_line()
    assert "starting" not in second.output()
    run = processes.start_executable(
        *("worm_optimizer", "operate", "run", "--stroke", "0.03", "--frequency", "0.4"),
        *("--cycles", "1", "--record", str(tmp_path / "bags"), "--json"),
        name="run",
    )
    assert run.wait(3 * TIMEOUT_S) == 0, run.output()
    (bag,) = (tmp_path / "bags").iterdir()
    assert (bag / "metadata.yaml").exists()
    start.signal(signal.SIGINT)
    assert start.wait(2 * TIMEOUT_S) == 0, start.output()


def test_after_a_crash_of_the_driver_the_last_line_warns_of_torque(
    processes: Processes, tmp_path: Path
):
    place = ("--set", f"directory={tmp_path / 'robot'}")
    start = processes.start_executable("worm_optimizer", "start", "--virtual", *place)
    start.wait_for_line("ready: ", READY_S)
    driver = next(
        int(file.parent.name)
        for file in Path("/proc").glob("[0-9]*/cmdline")
        if f"port:={json.dumps(str(tmp_path / 'robot' / 'servo_bus'))}" in command_line(file)
    )
    os.kill(driver, signal.SIGKILL)
    assert start.wait(2 * TIMEOUT_S) == 1
    assert start.last_line() == "start: the driver ended (exit status -9); torque may be on"


def command_line(file: Path) -> str:
    try:
        return file.read_text()
    except OSError:  # the process has ended
        return ""


def test_a_setting_that_is_not_there_is_bad_input(processes: Processes):
    start = processes.start_executable("worm_optimizer", "start", "--set", "prot=/dev/ttyUSB0")
    assert start.wait(TIMEOUT_S) == 2
    assert "no setting 'prot'" in start.last_line()
