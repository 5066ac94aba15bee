# SPDX-License-Identifier: Apache-2.0
"""The command start: the graph starts, accepts commands, rejects a second graph, and ends without traces."""

import os
import re
import signal
from pathlib import Path

import pytest
from harness import TIMEOUT_S, Processes

from worm_msgs.claim import DRIVER, ROBOT, holder

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
    assert re.search(
        r"/worm has a (virtual robot or player|driver) already, process \d+", second.last_line()
    )
    assert "activating" not in second.output()
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


def test_a_crash_of_the_driver_ends_all_nodes_of_a_robot_in_its_own_folder(
    processes: Processes, ros_domain: int
):
    start = processes.start_executable("worm_optimizer", "start", "--virtual")
    start.wait_for_line("ready: ", READY_S)
    assert Path(f"/tmp/worm_{ros_domain}/servo_bus").is_symlink()
    os.kill(holder(DRIVER, "worm", ros_domain), signal.SIGKILL)
    assert start.wait(2 * TIMEOUT_S) == 1
    assert start.last_line().startswith("start: driver ended with exit status -9")
    assert holder(ROBOT, "worm", ros_domain) == 0
