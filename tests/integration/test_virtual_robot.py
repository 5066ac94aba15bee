# SPDX-License-Identifier: Apache-2.0
"""The virtual robot as a process: its topics, its end, and a driver that hangs."""

import sys
from pathlib import Path

import pytest
from commander import parameters
from harness import TIMEOUT_S, ros_arguments
from lifecycle_msgs.msg import State, Transition

from worm_msgs.msg import BodyLength, Tracker


@pytest.fixture
def directory(tmp_path: Path) -> Path:
    return tmp_path / "robot"


@pytest.fixture
def robot(processes, directory):
    process = processes.start_node(
        "worm_driver", "virtual_robot", "--directory", str(directory), "--seed", "7"
    )
    process.wait_for_line("^ready: ", TIMEOUT_S)
    return process


def test_what_it_publishes_stands_in_the_past_and_in_order(robot, probe):
    positions = probe.collect(Tracker, "tracker")
    lengths = probe.collect(BodyLength, "body_length/measured")
    probe.wait_for(lambda: len(positions) >= 40 and len(lengths) >= 30, "samples of the camera")
    now = probe.node.get_clock().now().nanoseconds
    stamps = [m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in positions]
    assert stamps == sorted(stamps)
    assert stamps[-1] < now
    span = (stamps[-1] - stamps[0]) * 1e-9 / (len(stamps) - 1)
    assert span == pytest.approx(1 / 30, rel=0.1)
    assert {m.source for m in lengths} == {BodyLength.MEASURED}
    assert all(m.length == pytest.approx(0.2953, abs=0.002) for m in lengths)
    assert all(m.length_change == pytest.approx(0.0, abs=0.002) for m in lengths)


def test_a_directory_in_use_is_rejected_and_ctrl_c_leaves_nothing_behind(
    robot, processes, directory
):
    second = processes.start_executable(
        "worm_driver", "virtual_robot", "--directory", str(directory), name="second"
    )
    assert second.wait(TIMEOUT_S) == 2
    assert "in use" in second.output()
    assert (directory / "servo_bus").is_symlink()
    robot.interrupt()
    assert robot.wait(TIMEOUT_S) == 0
    assert list(directory.iterdir()) == []


_SLOW = """
import sys
import time
from worm_driver.control.robot import Robot
from worm_driver.nodes import driver_node, executables

activate = Robot.activate

def slow(robot, now):
    activate(robot, now)
    time.sleep(0.6)

Robot.activate, driver_node._ACTIVATION = slow, 0.2
sys.exit(executables.driver_node(sys.argv))
"""


@pytest.mark.night
def test_an_activation_that_takes_too_long_ends_inactive_and_released(
    processes, probe, commander, directory
):
    """The virtual robot does not wait for a driver that hangs: its time is the computer's."""
    robot = processes.start_node(
        "worm_driver", "virtual_robot", "--real-time", "--directory", str(directory)
    )
    robot.wait_for_line("^ready: ", TIMEOUT_S)
    given = parameters(directory, **{"bus_watchdog_s": 1.0, "limits.max_silence_s": 0.8})
    processes.start("slow", [sys.executable, "-c", _SLOW, *ros_arguments(**given)])
    assert commander.change(Transition.TRANSITION_CONFIGURE)
    assert not commander.change(Transition.TRANSITION_ACTIVATE)
    assert commander.lifecycle_state() == State.PRIMARY_STATE_INACTIVE

    def is_released() -> bool:
        # On a busy machine the thread of the servo bus is late, and the driver says that instead.
        return "the torque is off" in probe.rejection(commander.send())

    probe.wait_for(is_released, "reverted activation")
