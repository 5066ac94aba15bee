# SPDX-License-Identifier: Apache-2.0
"""The driver node as a process, on the virtual robot as another one: each test ends, breaks or sets its own driver."""

import signal
import sys
import time
from pathlib import Path

import pytest
from commander import (
    ABORTED,
    SERVOS,
    SUCCEEDED,
    Commander,
    goal_client,
    parameters,
    run_into_a_gait,
    stamp,
    torques,
)
from diagnostic_msgs.msg import DiagnosticStatus
from harness import LATCHED, TIMEOUT_S
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.qos import ReliabilityPolicy
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from worm_driver.servos.registers import COMMON
from worm_driver.servos.servo_bus import ServoBus
from worm_driver.virtual_robot.virtual_settings import DEFAULT_FILE
from worm_msgs.action import RunGait
from worm_msgs.msg import BodyLength, Gait, GaitState, Tracker


@pytest.fixture(autouse=True)
def state_directory(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Keep the emergency stop of one test from the next; set before any process is started."""
    monkeypatch.setenv("WORM_STATE_DIRECTORY", str(tmp_path / "state"))


@pytest.fixture
def directory(processes, tmp_path: Path) -> Path:
    """Start a virtual robot and return its directory."""
    path = tmp_path / "robot"
    robot = processes.start_node("worm_driver", "virtual_robot", "--directory", str(path))
    robot.wait_for_line("^ready: ", TIMEOUT_S)
    return path


@pytest.fixture
def real_time_directory(processes, tmp_path: Path) -> Path:
    """Start a virtual robot that does not wait for a driver that hangs: its time is the computer's."""
    path = tmp_path / "robot"
    robot = processes.start_node(
        "worm_driver", "virtual_robot", "--real-time", "--directory", str(path)
    )
    robot.wait_for_line("^ready: ", TIMEOUT_S)
    return path


@pytest.fixture
def driver(processes, directory):
    return processes.start_node("worm_driver", "driver_node", **parameters(directory))


@pytest.fixture
def commander(probe) -> Commander:
    return Commander(probe)


def test_stop_is_served_while_a_deactivation_returns_to_rest(
    processes, directory, commander, probe
):
    given = parameters(directory, return_speed_m_per_s=0.005)
    processes.start_node("worm_driver", "driver_node", **given)
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


def test_a_fault_while_a_deactivation_returns_to_rest_leaves_the_torque_on(
    processes, directory, commander, probe
):
    given = parameters(directory, return_speed_m_per_s=0.005)
    processes.start_node("worm_driver", "driver_node", **given)
    cable = run_into_a_gait(commander, probe)
    client = probe.node.create_client(ChangeState, "driver/change_state")
    probe.meet("driver/change_state")
    deactivate = Transition(id=Transition.TRANSITION_DEACTIVATE)
    changed = client.call_async(ChangeState.Request(transition=deactivate))
    probe.wait_for(
        lambda: commander.states[-1].message == "the driver is deactivated", "way back to rest"
    )
    commander.inject(name="no_answer", target=11, duration=3600.0)
    assert not probe.result(changed, "answer to the deactivation").success
    assert commander.lifecycle_state() == State.PRIMARY_STATE_ACTIVE
    commander.wait_for_state(GaitState.FAULT, "fault")
    commander.inject(name="clear")
    cable.clear()
    probe.wait_for(lambda: len(cable) > 50, "half a second")
    assert max(message.length_change for message in cable) < -0.005
    # accepted in FAULT, as the operator requests it
    assert commander.change(Transition.TRANSITION_DEACTIVATE)
    assert commander.lifecycle_state() == State.PRIMARY_STATE_INACTIVE


# --- measured rest, holds, several cable servos ----------------------------------------------------------


def test_a_slow_cable_is_at_rest_before_a_deactivation_releases_it(
    processes, directory, commander, probe
):
    slow = parameters(directory, **{"limits.max_cable_speed_m_per_s": 0.02})
    driver = processes.start_node("worm_driver", "driver_node", **slow)
    cable = probe.collect(BodyLength, "body_length/cable")
    commander.activate()
    commander.send(stroke=0.04, frequency=0.15)
    probe.wait_for(lambda: cable and cable[-1].length_change < -0.03, "contraction")
    assert commander.trigger("stop").success
    assert commander.change(Transition.TRANSITION_DEACTIVATE)
    released = probe.node.get_clock().now().nanoseconds
    probe.wait_for(lambda: stamp(cable[-1]) * 1e9 > released - 10**9, "cable after the release")
    assert cable[-1].length_change > -0.002
    assert "[ERROR]" not in driver.output()


def test_an_emergency_stop_that_is_repeated_moves_nothing(driver, commander, probe):
    cable = run_into_a_gait(commander, probe)
    commanded = probe.collect(BodyLength, "body_length/commanded")
    publisher = probe.node.create_publisher(Bool, "emergency_stop", 10)
    probe.wait_for(publisher.get_subscription_count, "subscription to the emergency stop")
    publisher.publish(Bool(data=True))
    probe.wait_for(lambda: commander.states[-1].holding, "hold")
    cable.clear()
    probe.wait_for(lambda: len(cable) > 100, "a second of rest")
    held = cable[-1].length_change
    commanded.clear()
    for _ in range(30):
        publisher.publish(Bool(data=True))
        cable.clear()
        probe.wait_for(lambda: len(cable) > 5, "further samples")
    assert len({message.length_change for message in commanded}) == 1
    assert cable[-1].length_change == pytest.approx(held, abs=5e-4)


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


# --- ways to end --------------------------------------------------------------------------------------


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_brings_the_gait_to_rest_and_releases(driver, commander, probe, directory, number):
    lengths = run_into_a_gait(commander, probe)
    result = commander.goal.get_result_async()
    driver.signal(number)
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


def stop_by(way: str, probe, client) -> None:
    """Stop the robot by the service or by the topic."""
    if way == "service":
        assert probe.result(client.call_async(Trigger.Request()), "answer to stop").success
    else:
        publisher = probe.node.create_publisher(Bool, "emergency_stop", LATCHED)
        publisher.publish(Bool(data=True))


@pytest.mark.parametrize("way", ["service", "topic"])
@pytest.mark.parametrize("end", ["signal", "shutdown"])
def test_a_stop_while_the_driver_shuts_down_leaves_the_robot_holding(
    processes, directory, commander, probe, end, way
):
    given = parameters(directory, return_speed_m_per_s=0.005)
    driver = processes.start_node("worm_driver", "driver_node", **given)
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
    stop_by(way, probe, stop)
    if end == "shutdown":
        assert not probe.result(changed, "answer to the shutdown").success
        driver.signal(signal.SIGTERM)
    probe.wait_for(lambda: driver.exit_code is not None, "end of the driver")
    assert driver.exit_code == 1
    driver.wait_for_line(r"ERROR.*torque stays on.*contracted by \d", TIMEOUT_S)
    assert cable[-1].length_change < -0.01
    assert torques(directory) == [1, 1, 1]


def test_a_second_ctrl_c_after_a_stop_releases_the_torque(processes, directory, commander, probe):
    """The second Ctrl-C switches it off, as documented."""
    given = parameters(directory, return_speed_m_per_s=0.005)
    driver = processes.start_node("worm_driver", "driver_node", **given)
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


# --- floods ---------------------------------------------------------------------------------------


def test_every_goal_of_a_flood_is_answered(driver, commander, probe):
    commander.activate()
    goals = goal_client(probe)
    goal = RunGait.Goal(gait=Gait(stroke=0.05, frequency=0.4, direction=1), cycles=100)
    sent = [goals.send_goal_async(goal) for _ in range(150)]
    probe.wait_for(lambda: all(call.done() for call in sent), "answer to every goal")
    assert sum(call.result().accepted for call in sent) == 1
    assert len(driver.output().splitlines()) < 100


_SLOW = """
import sys
import time
from worm_driver.nodes import driver_node
from worm_driver.errors import BusError
from worm_driver.control.robot import Robot

activate = Robot.activate

def slow(robot, now):
    activate(robot, now)
    time.sleep(0.6)

def refuse(robot, now, reason):
    raise BusError("sabotage")

{deed}
sys.exit(driver_node.main(sys.argv))
"""


def start_script(processes, path: Path, text: str, given: dict[str, object]):
    path.write_text(text)
    ros = ["--ros-args", "-r", "__ns:=/worm"]
    for key, value in given.items():
        ros += ["-p", f"{key}:={value}"]
    return processes.start("sabotaged", [sys.executable, str(path), *ros])


def test_an_activation_that_takes_too_long_ends_inactive_and_released(
    processes, commander, real_time_directory, tmp_path
):
    deed = "Robot.activate, driver_node._ACTIVATION = slow, 0.2"
    given = parameters(real_time_directory, **{"bus_watchdog_s": 1.0, "limits.max_silence_s": 0.8})
    start_script(processes, tmp_path / "slow.py", _SLOW.format(deed=deed), given)
    assert commander.change(Transition.TRANSITION_CONFIGURE)
    assert not commander.change(Transition.TRANSITION_ACTIVATE)
    assert commander.lifecycle_state() == State.PRIMARY_STATE_INACTIVE

    def is_released() -> bool:
        # On a busy machine the thread of the servo bus is late, and the driver says that instead.
        return "the torque is off" in commander.probe.rejection(commander.send())

    commander.probe.wait_for(is_released, "reverted activation")


def test_a_deactivation_that_fails_closes_and_releases_all_the_same(
    processes, commander, directory, tmp_path
):
    deed = "Robot.ramp_to_rest = refuse"
    given = parameters(directory)
    start_script(processes, tmp_path / "refusing.py", _SLOW.format(deed=deed), given)
    commander.activate()
    assert not commander.change(Transition.TRANSITION_DEACTIVATE)
    assert commander.lifecycle_state() == State.PRIMARY_STATE_UNCONFIGURED
    assert torques(directory) == [0, 0, 0]


_SABOTAGE = """
import sys
import rclpy
from worm_driver.nodes import driver_node

class Sabotaged(driver_node.TrackerListener):
    def _on_sample(self, message):
        if message.front_position - message.rear_position < 0.275:  # in the middle of a gait
            {deed}

driver_node.TrackerListener = Sabotaged
sys.exit(driver_node.main(sys.argv))
"""


@pytest.mark.parametrize(
    "deed",
    ["raise RuntimeError('sabotage')", "rclpy.shutdown()"],
    ids=["exception", "context gone"],
)
def test_whatever_ends_the_node_the_servos_are_released(
    processes, commander, directory, deed, tmp_path
):
    script = tmp_path / "sabotaged.py"
    driver = start_script(processes, script, _SABOTAGE.format(deed=deed), parameters(directory))
    commander.activate()
    commander.send(stroke=0.06, cycles=20)
    assert driver.wait(TIMEOUT_S) != 0
    assert torques(directory) == [0, 0, 0]


def test_after_a_kill_the_servos_stop_by_themselves(driver, commander, probe, directory):
    run_into_a_gait(commander, probe)
    seen = probe.collect(Tracker, "tracker")
    driver.kill()
    driver.wait(TIMEOUT_S)
    end = probe.node.get_clock().now().nanoseconds * 1e-9 + 1.5
    # a read of the servos would reset their watchdogs: the camera's stamps show that the time has passed
    probe.wait_for(lambda: seen and stamp(seen[-1]) > end, "passing time")
    bus = ServoBus.open(str(directory / "servo_bus"), 1_000_000, latency=0.1)
    assert [bus.read(servo, COMMON["bus_watchdog"]) for servo in SERVOS] == [-1, -1, -1]
    first = bus.read(1, COMMON["present_position"])
    assert bus.read(1, COMMON["present_position"]) == pytest.approx(first, abs=2)
    bus.close()


def test_after_a_kill_a_new_driver_takes_over(processes, commander, probe, directory):
    given = parameters(directory)
    first = processes.start_node("worm_driver", "driver_node", **given)
    run_into_a_gait(commander, probe)
    first.kill()
    first.wait(TIMEOUT_S)
    processes.processes.pop("driver_node")
    processes.start_node("worm_driver", "driver_node", **given, autostart="true")
    commander.wait_for_state(GaitState.IDLE, "second driver")
    goal = commander.send(cycles=1)
    assert commander.result(goal).status == SUCCEEDED


# --- parameters ------------------------------------------------------------------


def test_limits_take_effect_at_once_and_all_else_is_rejected_while_configured(driver, commander):
    commander.activate()
    assert commander.set_parameter("limits.max_stroke_m", 0.02).successful
    assert "limits.max_stroke_m" in commander.probe.rejection(commander.send(stroke=0.03))
    for name, lower, higher in (
        ("limits.max_stroke_m", 0.02, 0.2),
        ("limits.max_servo_current_a", 1.0, 1.1),
        ("return_speed_m_per_s", 0.04, 0.05),
    ):
        assert commander.set_parameter(name, lower).successful
        raised = commander.set_parameter(name, higher)
        assert not raised.successful
        assert f"{lower:g}" in raised.reason
        assert "lowered" in raised.reason
    assert not commander.set_parameter("use_sim_time", True).successful
    rejected = commander.set_parameter("port", "/dev/other")
    assert not rejected.successful
    assert "takes effect at configure" in rejected.reason
    assert commander.change(Transition.TRANSITION_DEACTIVATE)
    assert commander.change(Transition.TRANSITION_CLEANUP)
    assert commander.set_parameter("port", "/dev/other").successful
    assert commander.set_parameter("limits.max_stroke_m", 0.05).successful


def test_a_run_that_a_new_limit_does_not_allow_ends_at_rest(driver, commander):
    commander.activate()
    goal = commander.send(stroke=0.05, frequency=0.2, cycles=60)
    commander.wait_for_state(GaitState.RUNNING, "running gait")
    assert commander.set_parameter("limits.max_stroke_m", 0.02).successful
    assert "ended by a new limit" in commander.result(goal).result.message
    assert "ends at its next point of rest" in driver.output()


def test_a_user_may_change_the_quality_of_service_of_telemetry(
    processes, directory, commander, probe
):
    name = "qos_overrides./worm/power.publisher.reliability"
    given = parameters(directory, **{name: "best_effort"})
    processes.start_node("worm_driver", "driver_node", **given)
    commander.activate()
    (power,) = probe.node.get_publishers_info_by_topic("/worm/power")
    (joints,) = probe.node.get_publishers_info_by_topic("/worm/joint_states")
    assert power.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT
    assert joints.qos_profile.reliability == ReliabilityPolicy.RELIABLE


# --- reported faults -----------------------------------------------------------------------------------


def test_a_silent_servo_is_a_fault_that_is_named_and_cleared(driver, commander):
    commander.activate()
    goal = commander.send(stroke=0.06, cycles=20)
    commander.wait_for_state(GaitState.RUNNING, "running gait")
    commander.inject(name="no_answer", target=1, duration=3600.0)
    answer = commander.result(goal)
    assert answer.status == ABORTED
    assert "fault: servo 1 has returned no state" in answer.result.message
    assert "servo 1" in commander.wait_for_state(GaitState.FAULT, "fault").message
    (line,) = [line for line in driver.output().splitlines() if "FAULT: " in line]
    assert "[ERROR]" in line
    assert "servo 1 has returned no state" in line
    assert "then deactivate and activate" in line
    commander.wait_for_report(
        "worm/driver: gait", DiagnosticStatus.ERROR, "servo 1 has returned no state"
    )
    commander.wait_for_report("worm/driver: servo bus", DiagnosticStatus.WARN, "timeouts")
    assert "in fault" in commander.probe.rejection(commander.send())
    commander.inject(name="clear")
    assert commander.change(Transition.TRANSITION_DEACTIVATE)
    assert commander.change(Transition.TRANSITION_ACTIVATE)
    assert commander.result(commander.send(cycles=1)).status == SUCCEEDED


def test_an_unplugged_port_is_a_fault_and_a_new_configuration_mends_it(
    driver, commander, directory, probe
):
    run_into_a_gait(commander, probe)
    commander.inject(name="unplugged", duration=1.0)
    assert "is gone" in commander.wait_for_state(GaitState.FAULT, "fault").message
    commander.wait_for_report("worm/driver: gait", DiagnosticStatus.ERROR, "is gone")
    assert not commander.change(Transition.TRANSITION_DEACTIVATE)
    commander.wait_for_report("worm/driver: gait", DiagnosticStatus.ERROR, "torque may still be on")
    assert commander.lifecycle_state() == State.PRIMARY_STATE_UNCONFIGURED
    probe.wait_for((directory / "servo_bus").is_symlink, "port")
    commander.activate()
    commander.wait_for_state(GaitState.IDLE, "activation")


# --- wrong configuration ------------------------------------------------------------------------------


def test_a_robot_that_is_not_homed_waits_for_its_operator(processes, directory, commander):
    given = parameters(directory, autostart="true", home_at_start="false")
    driver = processes.start_node("worm_driver", "driver_node", **given)
    driver.wait_for_line(
        "cannot activate: the turn count of the cable servo is not known", TIMEOUT_S
    )
    commander.wait_for_report("worm/driver: gait", DiagnosticStatus.WARN, "not homed")
    assert commander.lifecycle_state() == State.PRIMARY_STATE_INACTIVE
    assert commander.trigger("home").success
    assert commander.change(Transition.TRANSITION_ACTIVATE)


# --- stress -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("active", [False, True])
def test_a_transition_that_the_state_does_not_have_is_rejected_and_the_node_lives(
    driver, commander, active
):
    if active:
        commander.activate()
    wrong = [Transition.TRANSITION_CLEANUP, Transition.TRANSITION_ACTIVE_SHUTDOWN, 99, 255]
    if active:
        wrong = [Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE, 99, 255]
    before = commander.lifecycle_state()
    for number in wrong:
        assert not commander.change(number)
    assert commander.lifecycle_state() == before
    driver.wait_for_line("there is no transition 99 .* only: ", TIMEOUT_S)
    assert commander.change(
        Transition.TRANSITION_DEACTIVATE if active else Transition.TRANSITION_CONFIGURE
    )


def test_a_deactivation_with_a_dead_line_fails_and_reports_the_known_state(driver, commander):
    commander.activate()
    commander.inject(name="no_answer", duration=3600.0)
    assert not commander.change(Transition.TRANSITION_DEACTIVATE)
    commander.wait_for_report(
        "worm/driver: gait", DiagnosticStatus.ERROR, "the torque may still be on: servo 1"
    )
    assert commander.lifecycle_state() == State.PRIMARY_STATE_UNCONFIGURED
