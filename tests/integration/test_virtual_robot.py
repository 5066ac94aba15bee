# SPDX-License-Identifier: Apache-2.0
"""The virtual robot as a process: its ports, its topics, its faults, its end."""

import sys
from contextlib import closing
from pathlib import Path

import pytest
from commander import parameters
from harness import TIMEOUT_S, ros_arguments
from lifecycle_msgs.msg import State, Transition

from worm_driver.power.socket_smbus import SocketSMBus
from worm_driver.servos.registers import COMMON
from worm_driver.servos.servo_bus import ServoBus
from worm_driver.virtual_robot.virtual_settings import DEFAULT_FILE
from worm_msgs.msg import BodyLength, Tracker
from worm_msgs.srv import InjectFault


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


def test_faults_on_request(robot, probe, directory):
    def inject(**fields):
        request = InjectFault.Request(**fields)
        return probe.call(InjectFault, "inject_fault", request)

    rejected = inject(name="fire")
    assert not rejected.success
    assert "choose one of" in rejected.message

    with closing(SocketSMBus(str(directory / "i2c.sock"))) as bus:
        assert bus.read_word_data(0x40, 0) == 0x9F39
        assert inject(name="i2c_nack", duration=3600.0).success

        def nacked():
            try:
                bus.read_word_data(0x40, 0)
            except OSError as error:
                return error.errno == 121
            return False

        probe.wait_for(nacked, "NACK")
        assert inject(name="clear").success
        probe.wait_for(lambda: not nacked(), "end of the NACKs")

    assert inject(name="unplugged", duration=3600.0).success
    probe.wait_for(lambda: not (directory / "servo_bus").is_symlink(), "unplugged port")


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


def test_cables_of_different_lengths_are_named_and_not_activated(
    processes, commander, probe, tmp_path
):
    """Another program has turned one spool of two since they were homed."""
    text = DEFAULT_FILE.read_text()
    one = "{id: 1, model: XM430-W350, sign: 1, spool_radius_m: 0.025, start_angle_rad: 5.0}"
    two = one.replace("id: 1", "id: 2")
    settings = tmp_path / "two_spools.yaml"
    settings.write_text(text.replace(f"  - {one}", f"  - {one}\n  - {two}"))
    robot = processes.start_node(
        "worm_driver", "virtual_robot", "--directory", str(tmp_path), "--parameters", str(settings)
    )
    robot.wait_for_line("^ready: ", TIMEOUT_S)
    spools = {"ids": "[1, 2]", "signs": "[1, 1]", "spool_radius_m": "[0.025, 0.025]"}
    given = parameters(tmp_path, **{f"cable_servos.{key}": value for key, value in spools.items()})
    driver = processes.start_node("worm_driver", "driver_node", **given)
    assert commander.change(Transition.TRANSITION_CONFIGURE)
    assert commander.change(Transition.TRANSITION_CLEANUP)
    bus = ServoBus.open(str(tmp_path / "servo_bus"), 1_000_000, latency=0.1)
    bus.write(2, COMMON["torque_enable"], 1)
    bus.write(2, COMMON["goal_position"], 208)  # 8 mm
    probe.wait_for(lambda: bus.read(2, COMMON["present_position"]) > 200, "turn of the spool")
    bus.write(2, COMMON["torque_enable"], 0)
    bus.close()
    assert commander.change(Transition.TRANSITION_CONFIGURE)
    assert not commander.change(Transition.TRANSITION_ACTIVATE)
    driver.wait_for_line(
        r"cannot activate: .*servo 1 is at -?0\.\d mm and servo 2 at -[78]\.\d mm", 5
    )


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
