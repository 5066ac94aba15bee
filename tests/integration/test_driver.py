# SPDX-License-Identifier: Apache-2.0
"""The driver node as a process, on the virtual robot as another one."""

import itertools
import math
import signal
import sys
import time
from pathlib import Path

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from harness import LATCHED, TIMEOUT_S
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.srv import GetParameters, ListParameters, SetParameters
from rclpy.action import ActionClient
from rclpy.parameter import Parameter
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from worm_driver.servos.registers import COMMON
from worm_driver.servos.servo_bus import ServoBus
from worm_msgs.action import RunGait
from worm_msgs.msg import BodyLength, Gait, GaitState, Power, Tracker
from worm_msgs.srv import InjectFault

SERVOS = (1, 11, 12)
SUCCEEDED, CANCELED, ABORTED = 4, 5, 6  # action_msgs/GoalStatus


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


def parameters(directory: Path, **changes: object) -> dict[str, object]:
    """Return the parameters of a driver on that robot, whose time waits if the test's machine is busy."""
    return {
        "port": directory / "servo_bus",
        "i2c_bus": directory / "i2c.sock",
        "cable_servos.spool_radius_m": "[0.025]",
        "home_at_start": "true",
        **changes,
    }


@pytest.fixture
def driver(processes, directory):
    return processes.start_node("worm_driver", "driver_node", **parameters(directory))


class Commander:
    """Client with all requests of an operator to the driver."""

    def __init__(self, probe) -> None:
        self.probe = probe
        self.states = probe.collect(GaitState, "gait_state", LATCHED)
        self.reports: list[DiagnosticArray] = probe.collect(DiagnosticArray, "/diagnostics")

    def change(self, transition: int) -> bool:
        request = ChangeState.Request(transition=Transition(id=transition))
        return self.probe.call(ChangeState, "driver/change_state", request).success

    def activate(self) -> None:
        assert self.change(Transition.TRANSITION_CONFIGURE)
        assert self.change(Transition.TRANSITION_ACTIVATE)

    def lifecycle_state(self) -> int:
        return self.probe.call(GetState, "driver/get_state", GetState.Request()).current_state.id

    def send(
        self,
        stroke=0.03,
        frequency=0.4,
        cycles=1,
        direction=Gait.FORWARD,
        feedback=None,
        **waveform,
    ):
        gait = Gait(stroke=stroke, frequency=frequency, direction=direction, **waveform)
        goal = RunGait.Goal(gait=gait, cycles=cycles)
        return self.probe.send_goal(RunGait, "run_gait", goal, feedback)

    def result(self, goal, timeout_s: float = TIMEOUT_S):
        return self.probe.result(goal.get_result_async(), "result of the gait", timeout_s)

    def set_parameter(self, name: str, value: object):
        message = Parameter(name, value=value).to_parameter_msg()
        request = SetParameters.Request(parameters=[message])
        return self.probe.call(SetParameters, "driver/set_parameters", request).results[0]

    def trigger(self, name: str) -> Trigger.Response:
        return self.probe.call(Trigger, name, Trigger.Request())

    def inject(self, **fields: object) -> None:
        request = InjectFault.Request(**fields)
        assert self.probe.call(InjectFault, "inject_fault", request).success

    def wait_for_state(self, state: int, what: str) -> GaitState:
        self.probe.wait_for(lambda: self.states and self.states[-1].state == state, what)
        return self.states[-1]

    def wait_for_report(self, name: str, level: bytes, expected: str) -> DiagnosticStatus:
        def found():
            statuses = [s for report in self.reports for s in report.status]
            return [
                s for s in statuses if s.name == name and s.level == level and expected in s.message
            ]

        return self.probe.wait_for(found, f"report of {name} with {expected!r}")[0]


@pytest.fixture
def commander(probe) -> Commander:
    return Commander(probe)


def torques(directory: Path) -> list[int]:
    """Return the torque of each servo, read by the test itself when the driver has closed the port."""
    bus = ServoBus.open(str(directory / "servo_bus"), 1_000_000, latency=0.1)
    try:
        return [bus.read(servo, COMMON["torque_enable"]) for servo in SERVOS]
    finally:
        bus.close()


def stamp(message) -> float:
    return message.header.stamp.sec + message.header.stamp.nanosec * 1e-9


# --- gaits -----------------------------------------------------------------------------------------


def test_a_gait_from_rest_to_figures(driver, commander, probe):
    feedback = []
    commander.activate()
    commander.wait_for_state(GaitState.IDLE, "activation")
    goal = commander.send(cycles=2, feedback=lambda m: feedback.append(m.feedback))
    answer = commander.result(goal)
    result = answer.result
    assert answer.status == SUCCEEDED
    assert result.success
    assert (result.cycles_completed, result.cycles_averaged) == (2, 2)
    assert result.idle_power == pytest.approx(0.84, abs=0.1)
    assert result.power > result.idle_power + 0.1
    assert math.isfinite(result.speed)
    seen = [state.state for state in commander.states]
    order = [GaitState.RESTING, GaitState.RUNNING, GaitState.IDLE]
    assert [state for state in dict.fromkeys(seen) if state in order[:2]] == order[:2]
    assert feedback[0].elapsed <= 0.0
    assert feedback[-1].cycle == 2
    assert math.isfinite(feedback[-1].distance)
    assert math.isfinite(feedback[-1].power)


def test_every_cycle_is_published_with_its_stamp(driver, commander, probe):
    topics = {
        "joint_states": probe.collect(JointState, "joint_states"),
        "body_length/cable": probe.collect(BodyLength, "body_length/cable"),
        "body_length/commanded": probe.collect(BodyLength, "body_length/commanded"),
        "power": probe.collect(Power, "power"),
    }
    commander.activate()
    probe.wait_for(lambda: all(len(found) > 200 for found in topics.values()), "two seconds")
    for name, messages in topics.items():
        stamps = [stamp(message) for message in messages]
        assert stamps == sorted(set(stamps)), name
        assert stamps[-1] <= probe.node.get_clock().now().nanoseconds * 1e-9

    def cycles() -> int:
        """Return the number of cycles in the driver's latest report."""
        statuses = [s for report in commander.reports for s in report.status]
        timings = [s for s in statuses if s.name == "worm/driver: timing"]
        return max((int({v.key: v.value for v in s.values}["cycles"]) for s in timings), default=0)

    made = probe.wait_for(lambda: cycles() >= 200 and cycles(), "200 cycles")
    probe.wait_for(lambda: len(topics["joint_states"]) >= made, "one message per cycle")
    assert topics["joint_states"][0].name == ["cable_1", "fin_11", "fin_12"]
    assert {m.source for m in topics["body_length/cable"]} == {BodyLength.CABLE}
    assert {m.source for m in topics["body_length/commanded"]} == {BodyLength.COMMANDED}
    assert topics["body_length/cable"][-1].length == pytest.approx(0.2952, abs=1e-3)


def test_diagnostics_name_every_part(driver, commander, probe):
    commander.activate()

    def latest() -> dict[str, DiagnosticStatus]:
        return {
            status.name: status for report in commander.reports[-1:] for status in report.status
        }

    parts = (
        "gait",
        "servo bus",
        "timing",
        "servo 1",
        "servo 11",
        "servo 12",
        "power sensor",
        "network",
    )
    names = {f"worm/driver: {part}" for part in parts}
    probe.wait_for(lambda: set(latest()) == names, "report on every part")
    for part in ("gait", "servo 1", "servo 11", "servo 12", "power sensor"):
        commander.wait_for_report(f"worm/driver: {part}", DiagnosticStatus.OK, "")
    timing = {value.key: value.value for value in latest()["worm/driver: timing"].values}
    assert {"p99_period_error_s", "missed_deadlines", "mean_period_s"} <= set(timing)


# --- rejected goals ---------------------------------------------------------------------------------


def test_goals_that_cannot_be_played_are_rejected_with_the_reason(driver, commander, probe):
    assert "not configured" in probe.rejection(commander.send())
    commander.activate()
    for stroke, frequency, expected in (
        (math.nan, 0.2, "stroke: nan"),
        (0.07, -0.2, "frequency: -0.2"),
        (0.5, 0.2, "limits.max_stroke_m"),
    ):
        assert expected in probe.rejection(commander.send(stroke, frequency))
    for name, value in (
        ("pretension", -0.01),
        ("contraction_share", math.nan),
        ("profile", 7),
        ("ramp_share", 0.0),
    ):
        assert name in probe.rejection(commander.send(**{name: value}))
    first = commander.send(cycles=1)
    assert "running already" in probe.rejection(commander.send(cycles=1))
    assert commander.result(first).status == SUCCEEDED


def test_cancel_ends_at_rest(driver, commander, probe):
    lengths = probe.collect(BodyLength, "body_length/commanded")
    commander.activate()
    goal = commander.send(cycles=20)
    commander.wait_for_state(GaitState.RUNNING, "running gait")
    probe.result(goal.cancel_goal_async(), "answer to the cancellation")
    answer = commander.result(goal)
    assert answer.status == CANCELED
    assert answer.result.cycles_completed == 1
    assert "cancelled, at rest after 1 cycles" in answer.result.message
    probe.wait_for(lambda: lengths[-1].length_change == 0.0, "rest")


def test_a_gait_right_after_another_leaves_both_their_results(driver, commander, probe):
    """The first result waits for camera samples slightly longer than its motion lasts."""
    commander.activate()
    first = commander.send(cycles=1)
    commander.wait_for_state(GaitState.RUNNING, "first gait")
    commander.wait_for_state(GaitState.IDLE, "end of the first gait")
    second = commander.send(cycles=1)
    assert commander.result(second).status == SUCCEEDED
    assert commander.result(first).status == SUCCEEDED


def test_stop_holds_at_once_and_the_next_gait_returns_to_rest_first(driver, commander, probe):
    lengths = probe.collect(BodyLength, "body_length/commanded")
    commander.activate()
    goal = commander.send(stroke=0.06, cycles=5)
    contracted = lambda: lengths and lengths[-1].length_change < -0.02  # noqa: E731
    probe.wait_for(contracted, "contraction")
    assert commander.trigger("stop").success
    answer = commander.result(goal)
    assert answer.status == ABORTED
    assert "stopped: the service stop was called" in answer.result.message
    held = commander.wait_for_state(GaitState.IDLE, "hold")
    assert "stop was called" in held.message
    assert lengths[-1].length_change < -0.015
    assert commander.result(commander.send(cycles=1)).status == SUCCEEDED
    probe.wait_for(lambda: lengths[-1].length_change == 0.0, "rest")


SHAPED = {
    "pretension": 0.012,
    "contraction_share": 0.6,
    "profile": Gait.TRAPEZOID,
    "ramp_share": 0.2,
}


def test_a_shaped_gait_is_stopped_and_then_played_to_its_end(driver, commander, probe):
    commanded = probe.collect(BodyLength, "body_length/commanded")
    commander.activate()
    probe.wait_for(lambda: commanded, "first command")
    stopped = commander.send(stroke=0.05, cycles=5, **SHAPED)
    running = commander.wait_for_state(GaitState.RUNNING, "shaped gait")
    played = {name: getattr(running.gait, name) for name in SHAPED}
    assert played == pytest.approx(SHAPED)
    onset = running.onset.sec + running.onset.nanosec * 1e-9
    probe.wait_for(lambda: commanded[-1].length_change < -0.03, "contraction")
    assert commander.trigger("stop").success
    assert commander.result(stopped).status == ABORTED
    probe.wait_for(lambda: stamp(commanded[-1]) > onset + 1.0, "commands of a second")
    tensioned = [m.length_change for m in commanded if onset - 0.8 <= stamp(m) < onset]
    assert set(tensioned) == {-0.012}

    begin = len(commanded)
    goal = commander.send(stroke=0.05, cycles=1, **SHAPED)
    answer = commander.result(goal)
    assert answer.status == SUCCEEDED
    assert answer.result.cycles_completed == 1
    assert math.isfinite(answer.result.idle_power)
    probe.wait_for(lambda: commanded[-1].length_change == 0.0, "return to rest")
    changes = [m.length_change for m in commanded[begin:]]
    assert min(changes) == pytest.approx(-0.062, abs=2e-4)
    commander.wait_for_state(GaitState.IDLE, "rest")


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


def test_during_an_emergency_stop_a_deactivation_does_not_move_the_robot(driver, commander, probe):
    cable = probe.collect(BodyLength, "body_length/cable")
    commander.activate()
    assert commander.send(stroke=0.03, cycles=200, pretension=0.02).accepted
    probe.wait_for(lambda: cable and cable[-1].length_change < -0.03, "contraction")
    button = probe.node.create_publisher(Bool, "emergency_stop", LATCHED)
    button.publish(Bool(data=True))
    probe.wait_for(lambda: commander.states[-1].emergency_stop, "emergency stop")
    commander.wait_for_state(GaitState.IDLE, "hold")
    assert not commander.change(Transition.TRANSITION_DEACTIVATE)
    assert commander.lifecycle_state() == State.PRIMARY_STATE_ACTIVE
    cable.clear()
    probe.wait_for(lambda: len(cable) > 50, "half a second")
    assert max(message.length_change for message in cable) < -0.015
    button.publish(Bool(data=False))
    reset = Trigger.Request()
    probe.wait_for(lambda: probe.call(Trigger, "reset_emergency_stop", reset).success, "reset")
    assert commander.change(Transition.TRANSITION_DEACTIVATE)
    assert commander.lifecycle_state() == State.PRIMARY_STATE_INACTIVE


# --- ways to end --------------------------------------------------------------------------------------


def run_into_a_gait(commander, probe) -> list[BodyLength]:
    lengths = probe.collect(BodyLength, "body_length/cable")
    commander.activate()
    commander.goal = commander.send(stroke=0.06, cycles=20)
    probe.wait_for(lambda: lengths and lengths[-1].length_change < -0.02, "contraction")
    return lengths


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


def test_deactivation_brings_the_gait_to_rest_and_releases(driver, commander, probe, directory):
    run_into_a_gait(commander, probe)
    assert commander.change(Transition.TRANSITION_DEACTIVATE)
    assert commander.lifecycle_state() == State.PRIMARY_STATE_INACTIVE
    assert commander.change(Transition.TRANSITION_CLEANUP)
    assert torques(directory) == [0, 0, 0]
    commander.activate()


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

EVERY_ANSWER = QoSProfile(history=HistoryPolicy.KEEP_ALL)  # by default a client keeps the last ten


def goal_client(probe) -> ActionClient:
    client = ActionClient(
        probe.node,
        RunGait,
        "run_gait",
        goal_service_qos_profile=EVERY_ANSWER,
        result_service_qos_profile=EVERY_ANSWER,
    )
    probe.meet("run_gait/_action/send_goal")
    probe.wait_for(client.server_is_ready, "action run_gait")
    return client


def test_no_goal_that_was_received_before_a_stop_is_played_after_it(driver, commander, probe):
    run_into_a_gait(commander, probe)
    client = goal_client(probe)
    stop = probe.node.create_client(Trigger, "stop")
    probe.meet("stop")
    goal = RunGait.Goal(gait=Gait(stroke=0.05, frequency=0.4, direction=1), cycles=1)
    sent = [client.send_goal_async(goal) for _ in range(50)]
    stopped = stop.call_async(Trigger.Request())
    assert probe.result(stopped, "answer to stop").success
    probe.wait_for(lambda: all(future.done() for future in sent), "answer to every goal")
    accepted = [future.result() for future in sent if future.result().accepted]
    results = [probe.result(handle.get_result_async(), "result") for handle in accepted]
    assert all(result.status == ABORTED for result in results)
    # the state has another topic than the results: it may arrive after them
    probe.wait_for(
        lambda: commander.states[-1].message == "the service stop was called",
        "state after the stop",
    )
    assert {state.run for state in commander.states} == {0, 1}
    # a goal that is sent afterwards is played
    assert commander.result(commander.send(cycles=1)).status == SUCCEEDED


def test_every_goal_and_every_lifecycle_request_of_a_flood_is_answered(driver, commander, probe):
    commander.activate()
    goals = goal_client(probe)
    changes = probe.node.create_client(ChangeState, "driver/change_state", qos_profile=EVERY_ANSWER)
    states = probe.node.create_client(GetState, "driver/get_state", qos_profile=EVERY_ANSWER)
    probe.meet("driver/change_state")
    goal = RunGait.Goal(gait=Gait(stroke=0.05, frequency=0.4, direction=1), cycles=0)
    flip = itertools.cycle([Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_ACTIVATE])
    calls = []
    for _ in range(150):
        calls.append(goals.send_goal_async(goal))
        change = ChangeState.Request(transition=Transition(id=next(flip)))
        calls.append(changes.call_async(change))
        calls.append(states.call_async(GetState.Request()))
        due = time.monotonic() + 0.005  # 200 per second of each
        while time.monotonic() < due:
            probe.spin_once(0.001)
    probe.wait_for(lambda: all(call.done() for call in calls), "answer to every request")
    assert driver.exit_code is None
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
    assert "the torque is off" in commander.probe.rejection(commander.send())


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


# --- parameters of a running driver ------------------------------------------------------------------


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


def test_a_driver_accepts_its_own_parameters_as_ros2_param_load_sets_them(driver, commander, probe):
    """All parameters have their present values, including read-only ones and those that only a cleanup would permit."""
    commander.activate()
    names = probe.call(ListParameters, "driver/list_parameters", ListParameters.Request())
    get = GetParameters.Request(names=names.result.names)
    values = probe.call(GetParameters, "driver/get_parameters", get).values
    assert len(values) == len(get.names) > 30
    own = [ParameterMessage(name=n, value=v) for n, v in zip(get.names, values, strict=True)]
    request = SetParameters.Request(parameters=own)
    results = probe.call(SetParameters, "driver/set_parameters", request).results
    assert [n for n, r in zip(get.names, results, strict=True) if not r.successful] == []


def test_simulated_time_is_rejected_at_the_start(processes, directory):
    given = parameters(directory, use_sim_time=True)
    driver = processes.start_node("worm_driver", "driver_node", **given)
    assert driver.wait(TIMEOUT_S) == 2
    assert "use_sim_time" in driver.last_line()


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


def test_faults_of_the_power_sensor_are_samples_without_a_value(driver, commander, probe):
    samples = probe.collect(Power, "power")
    commander.activate()

    def seen(status: int):
        return lambda: [sample for sample in samples if sample.status == status]

    for name, status, expected in (
        ("i2c_nack", Power.BUS_ERROR, "bus error"),
        ("ina219_overflow", Power.OVERFLOW, "overflow"),
        ("ina219_reset", Power.SENSOR_RESET, "sensor reset"),
    ):
        commander.inject(name=name)
        found = probe.wait_for(seen(status), f"sample with {expected}")
        assert all(math.isnan(sample.power) for sample in found)
        commander.wait_for_report("worm/driver: power sensor", DiagnosticStatus.WARN, expected)
    count = len(seen(Power.VALID)())
    probe.wait_for(lambda: len(seen(Power.VALID)()) > count + 10, "valid samples")


# --- wrong configuration ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"port": "/dev/no_worm"}, "/dev/no_worm does not exist"),
        ({"i2c_bus": "/dev/i2c-77"}, "I2C bus /dev/i2c-77 does not exist"),
        ({"i2c_address": "69"}, "0x45 .*does not acknowledge"),
        ({"cable_servos.ids": "[9]"}, "servo 9 does not answer .* id"),
        ({"baud_rate": "115200"}, "does not answer .* at 115200 baud"),
        ({"cable_servos.signs": "[2]"}, "sign of cable servo 1 must be 1 or -1"),
        ({"cable_servos.ids": "[1, 2]"}, "one entry per servo"),
    ],
    ids=["port", "bus", "address", "id", "baud rate", "sign", "lengths"],
)
def test_a_wrong_configuration_is_reported_in_one_line(processes, directory, change, expected):
    given = parameters(directory, **{"autostart": "true", **change})
    driver = processes.start_node("worm_driver", "driver_node", **given)
    assert driver.wait(TIMEOUT_S) in (1, 2)
    driver.wait_for_line(f"^driver: .*{expected}", TIMEOUT_S)
    assert "Traceback" not in driver.output()


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


def test_a_robot_without_fin_servos_needs_none(processes, directory, commander):
    none = {f"fin_servos.{key}": "[]" for key in ("ids", "forward_angle_rad", "reverse_angle_rad")}
    processes.start_node("worm_driver", "driver_node", **parameters(directory, **none))
    commander.activate()
    commander.wait_for_state(GaitState.IDLE, "activation")


def test_a_parameter_out_of_its_range_is_rejected_in_one_line(processes, directory):
    given = parameters(directory, **{"limits.max_stroke_m": -1.0})
    driver = processes.start_node("worm_driver", "driver_node", **given)
    assert driver.wait(TIMEOUT_S) == 2
    driver.wait_for_line("^driver: .*limits.max_stroke_m", TIMEOUT_S)


def test_a_failed_configuration_leaves_the_node_unconfigured_and_can_be_repeated(
    driver, commander, directory, probe
):
    commander.inject(name="i2c_nack", duration=3600.0)
    assert not commander.change(Transition.TRANSITION_CONFIGURE)
    assert commander.lifecycle_state() == State.PRIMARY_STATE_UNCONFIGURED
    commander.wait_for_report("worm/driver: gait", DiagnosticStatus.ERROR, "does not acknowledge")
    commander.inject(name="clear")
    commander.activate()


def test_a_second_driver_in_the_namespace_ends_before_it_serves_anything(
    driver, processes, commander, directory
):
    """It needs no discovery: here it cannot discover any other process."""
    commander.activate()
    given = {**parameters(directory), "autostart": "true", "port": "/dev/none"}
    processes._env["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "OFF"
    arguments = ["--ros-args", "-r", "__ns:=/worm"]
    for key, value in given.items():
        arguments += ["-p", f"{key}:={value}"]
    second = processes.start_executable("worm_driver", "driver_node", *arguments, name="second")
    assert second.wait(TIMEOUT_S) == 2
    second.wait_for_line(f"/worm has a driver already, process {driver.pid} ", TIMEOUT_S)
    assert commander.lifecycle_state() == State.PRIMARY_STATE_ACTIVE


def test_a_second_driver_on_the_same_port_is_rejected(driver, processes, commander, directory):
    commander.activate()
    given = parameters(directory, autostart="true")
    ros = ["--ros-args", "-r", "__ns:=/other"]
    for key, value in given.items():
        ros += ["-p", f"{key}:={value}"]
    second = processes.start_executable("worm_driver", "driver_node", *ros, name="second")
    assert second.wait(TIMEOUT_S) == 1
    second.wait_for_line("in use by another program", TIMEOUT_S)


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


def test_stop_answers_every_call_of_a_flood(driver, commander, probe):
    commander.activate()
    every_answer = QoSProfile(
        history=HistoryPolicy.KEEP_ALL
    )  # by default a client keeps the last ten
    client = probe.node.create_client(Trigger, "stop", qos_profile=every_answer)
    probe.meet("stop")
    calls = [client.call_async(Trigger.Request()) for _ in range(1000)]
    probe.wait_for(lambda: all(call.done() for call in calls), "answer to every stop")
    assert all(call.result().success for call in calls)


def test_diagnostics_report_which_computers_can_discover_the_driver(driver, commander):
    commander.wait_for_report("worm/driver: network", DiagnosticStatus.OK, "this machine only")


# --- on a busy machine ---------------------------------------------------------------------------------


def test_on_a_busy_machine_no_deadline_is_missed_and_no_servo_is_blamed(
    driver, commander, processes, probe
):
    """With the default limits, and more work than processors: the robot's time waits."""
    for number in range(4):
        processes.start(f"work_{number}", [sys.executable, "-c", "while True: pass"])
    commander.activate()
    joints = probe.collect(JointState, "joint_states")
    assert commander.result(commander.send(cycles=2), 100.0).status == SUCCEEDED
    # Activation takes time of the robot between two samples, and the first of them may arrive only now.
    accepted = stamp(next(state for state in commander.states if state.run == 1))
    stamps = [time for time in map(stamp, joints) if time >= accepted]
    periods = [after - before for before, after in itertools.pairwise(stamps)]
    assert len(periods) > 300
    assert periods == pytest.approx([0.01] * len(periods), abs=1e-4)
    commander.reports.clear()
    timing = commander.wait_for_report("worm/driver: timing", DiagnosticStatus.OK, "")
    values = {value.key: value.value for value in timing.values}
    assert values["missed_deadlines"] == "0"
    assert "virtual" in values["real_time_priority"]
