# SPDX-License-Identifier: Apache-2.0
"""Drivers that each test ends, breaks or sets, on a virtual robot that all tests share."""

import signal
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from commander import (
    ABORTED,
    SERVOS,
    SUCCEEDED,
    parameters,
    run_into_a_gait,
    servo_bus,
    stamp,
    torques,
)
from diagnostic_msgs.msg import DiagnosticStatus
from harness import LATCHED, TIMEOUT_S, ros_arguments
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.qos import ReliabilityPolicy
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from worm_driver.servos.registers import COMMON
from worm_msgs.msg import BodyLength, GaitState, Tracker
from worm_optimizer.operation.processes import Process

# one process runs all, so that they share one virtual robot
pytestmark = pytest.mark.xdist_group("driver")

SLOW_RETURN = {"return_speed_m_per_s": 0.005}


@pytest.fixture
def ros_domain(robot, module_domain: int) -> int:
    """Let probe and processes of each test join the shared robot."""
    return module_domain


@pytest.fixture
def start(robot, commander) -> Iterator[Callable[..., Process]]:
    """Start the only driver of a test, with parameters."""
    yield robot.start_driver
    robot.end_driver(commander)


@pytest.fixture
def driver(start) -> Process:
    return start()


def test_stop_is_served_while_a_deactivation_returns_to_rest(start, commander, probe):
    start(**SLOW_RETURN)
    commanded = probe.collect(BodyLength, "body_length/commanded")
    cable = run_into_a_gait(commander, probe)
    stop = probe.node.create_client(Trigger, "stop")
    client = probe.node.create_client(ChangeState, "driver/change_state")
    probe.meet("driver/change_state")
    deactivate = Transition(id=Transition.TRANSITION_DEACTIVATE)
    changed = client.call_async(ChangeState.Request(transition=deactivate))
    probe.wait_for(
        lambda: commander.states[-1].message == "the driver is deactivated", "way back to rest"
    )
    assert not changed.done()
    assert probe.result(stop.call_async(Trigger.Request()), "answer to stop").success
    stopped = probe.node.get_clock().now().nanoseconds * 1e-9

    def lengths(messages, since: float) -> list[float]:
        return [m.length_change for m in messages if stamp(m) > since]

    probe.wait_for(lambda: len(lengths(cable, stopped + 0.1)) > 50, "half a second of rest")
    assert len(set(lengths(commanded, stopped))) == 1
    still = lengths(cable, stopped + 0.1)
    assert max(still) - min(still) < 5e-4
    assert still[-1] < -0.005
    assert not probe.result(changed, "answer to the deactivation").success
    assert commander.lifecycle_state() == State.PRIMARY_STATE_ACTIVE
    assert "stop was called" in commander.states[-1].message


def test_ctrl_c_brings_the_gait_to_rest_and_releases(driver, commander, probe, directory):
    lengths = run_into_a_gait(commander, probe)
    result = commander.goal.get_result_async()
    driver.interrupt()
    assert probe.result(result, "result of the goal").status == ABORTED
    probe.wait_for(lambda: driver.exit_code is not None, "end of the driver")
    assert driver.exit_code == 0
    assert torques(directory) == [0, 0, 0]
    assert commander.wait_for_state(GaitState.INACTIVE, "last word").message == "the driver ends"
    probe.wait_for(lambda: abs(lengths[-1].length_change) < 2e-3, "cable at rest")


def test_shutdown_while_active_releases(driver, commander, probe, directory):
    run_into_a_gait(commander, probe)
    assert commander.change(Transition.TRANSITION_ACTIVE_SHUTDOWN)
    assert torques(directory) == [0, 0, 0]


@pytest.mark.parametrize(("end", "way"), [("signal", "topic"), ("shutdown", "service")])
def test_a_stop_while_the_driver_shuts_down_leaves_the_robot_holding(
    start, directory, commander, probe, end, way
):
    driver = start(**SLOW_RETURN)
    cable = run_into_a_gait(commander, probe)
    stop = probe.node.create_client(Trigger, "stop")
    probe.meet("stop")
    if end == "signal":
        driver.signal(signal.SIGTERM)
        reason = "the driver ends"
    else:
        client = probe.node.create_client(ChangeState, "driver/change_state")
        shutdown = Transition(id=Transition.TRANSITION_ACTIVE_SHUTDOWN)
        changed = client.call_async(ChangeState.Request(transition=shutdown))
        reason = "the driver shuts down"
    probe.wait_for(lambda: commander.states[-1].message == reason, "way back to rest")
    if way == "service":
        assert probe.result(stop.call_async(Trigger.Request()), "answer to stop").success
    else:
        button = probe.node.create_publisher(Bool, "emergency_stop", LATCHED)
        button.publish(Bool(data=True))
    if end == "shutdown":
        assert not probe.result(changed, "answer to the shutdown").success
        driver.signal(signal.SIGTERM)
    probe.wait_for(lambda: driver.exit_code is not None, "end of the driver")
    assert driver.exit_code == 1
    driver.wait_for_line(r"ERROR.*torque stays on.*contracted by \d", TIMEOUT_S)
    assert cable[-1].length_change < -0.01
    assert torques(directory) == [1, 1, 1]


def test_a_second_ctrl_c_releases_the_torque(start, directory, commander, probe):
    driver = start(**SLOW_RETURN)
    run_into_a_gait(commander, probe)
    driver.signal(signal.SIGINT)
    probe.wait_for(lambda: commander.states[-1].message == "the driver ends", "way back to rest")
    states = len(commander.states)
    since = time.monotonic()
    probe.wait_for(lambda: time.monotonic() > since + 1.6, "time between two presses")
    driver.signal(signal.SIGINT)
    probe.wait_for(lambda: driver.exit_code is not None, "end of the driver")
    assert len(commander.states) >= states
    assert torques(directory) == [0, 0, 0]


_SABOTAGE = """
import sys
import rclpy
from worm_driver.nodes import driver_node, executables
from worm_driver.driver_errors import BusError
from worm_driver.control.robot import Robot

def refuse(robot, now, reason):
    raise BusError("sabotage")

class Sabotaged(driver_node.TrackerListener):
    def _on_sample(self, message):
        if message.front_position - message.rear_position < 0.275:  # in the middle of a gait
            {deed}

{change}
sys.exit(executables.driver_node(sys.argv))
"""


def start_script(processes, path: Path, text: str, given: dict[str, object]):
    path.write_text(text)
    return processes.start("sabotaged", [sys.executable, str(path), *ros_arguments(**given)])


def test_a_deactivation_that_fails_closes_and_releases_all_the_same(
    start, processes, commander, directory, tmp_path
):
    text = _SABOTAGE.format(deed="pass", change="Robot.ramp_to_rest = refuse")
    refusing = start_script(processes, tmp_path / "refusing.py", text, parameters(directory))
    commander.activate()
    assert not commander.change(Transition.TRANSITION_DEACTIVATE)
    assert commander.lifecycle_state() == State.PRIMARY_STATE_UNCONFIGURED
    assert torques(directory) == [0, 0, 0]
    refusing.kill()
    refusing.wait(TIMEOUT_S)


@pytest.mark.parametrize(
    "deed",
    ["raise RuntimeError('sabotage')", "rclpy.shutdown()"],
    ids=["exception", "context gone"],
)
def test_whatever_ends_the_node_the_servos_are_released(
    start, processes, commander, directory, deed, tmp_path
):
    text = _SABOTAGE.format(deed=deed, change="driver_node.TrackerListener = Sabotaged")
    driver = start_script(processes, tmp_path / "sabotaged.py", text, parameters(directory))
    commander.activate()
    commander.send(stroke=0.06, cycles=20)
    assert driver.wait(TIMEOUT_S) != 0
    assert torques(directory) == [0, 0, 0]


def test_after_a_kill_the_servos_stop_by_themselves_and_a_new_driver_takes_over(
    robot, driver, commander, probe, directory
):
    run_into_a_gait(commander, probe)
    seen = probe.collect(Tracker, "tracker")
    driver.kill()
    driver.wait(TIMEOUT_S)
    end = stamp(probe.wait_for(lambda: seen, "camera")[-1]) + 1.5
    # a read of the servos would reset their watchdogs: the camera's stamps show that the time has passed
    probe.wait_for(lambda: seen and stamp(seen[-1]) > end, "passing time")
    with servo_bus(directory) as bus:
        assert [bus.read(servo, COMMON["bus_watchdog"]) for servo in SERVOS] == [-1, -1, -1]
        first = bus.read(1, COMMON["present_position"])
        assert bus.read(1, COMMON["present_position"]) == pytest.approx(first, abs=2)
    robot.processes.forget("driver_node")
    robot.start_driver(autostart="true")
    commander.wait_for_state(GaitState.IDLE, "second driver")
    assert commander.result(commander.send(cycles=1)).status == SUCCEEDED


def test_a_user_may_change_the_quality_of_service_of_telemetry(start, commander, probe):
    start(**{"qos_overrides./worm/power.publisher.reliability": "best_effort"})
    commander.activate()
    (power,) = probe.node.get_publishers_info_by_topic("/worm/power")
    (joints,) = probe.node.get_publishers_info_by_topic("/worm/joint_states")
    assert power.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT
    assert joints.qos_profile.reliability == ReliabilityPolicy.RELIABLE


def test_a_robot_that_is_not_homed_waits_for_its_operator(start, robot, commander):
    with servo_bus(robot.directory) as bus:
        bus.write(1, COMMON["led"], 0)  # a cable servo that is lit is homed
    driver = start(autostart="true", home_at_start="false")
    driver.wait_for_line(
        "cannot activate: the turn count of the cable servo is not known", TIMEOUT_S
    )
    commander.wait_for_report("worm/driver: gait", DiagnosticStatus.WARN, "not homed")
    assert commander.lifecycle_state() == State.PRIMARY_STATE_INACTIVE
    assert commander.trigger("home").success
    assert commander.change(Transition.TRANSITION_ACTIVATE)
