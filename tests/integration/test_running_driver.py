# SPDX-License-Identifier: Apache-2.0
"""A driver that goes on: tests that share one and its virtual robot, and leave it unconfigured and without faults."""

import math
import re
from collections.abc import Iterator

import pytest
from commander import (
    ABORTED,
    CANCELED,
    EVERY_ANSWER,
    SUCCEEDED,
    Commander,
    goal_client,
    parameters,
    run_into_a_gait,
    stamp,
    torques,
)
from diagnostic_msgs.msg import DiagnosticStatus
from harness import LATCHED, TIMEOUT_S, ros_arguments
from lifecycle_msgs.msg import State, Transition
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.srv import GetParameters, ListParameters, SetParameters
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from worm_driver.nodes import executables
from worm_msgs.action import RunGait
from worm_msgs.msg import BodyLength, Gait, GaitState, Power
from worm_optimizer.operation.processes import Process

# one process runs all, so that they share one driver
pytestmark = pytest.mark.xdist_group("running driver")


@pytest.fixture
def ros_domain(robot, module_domain: int) -> int:
    """Let probe and processes of each test join the shared robot."""
    return module_domain


@pytest.fixture
def driver(robot, commander: Commander) -> Iterator[Process]:
    """Return the driver, unconfigured. Afterwards bring it to this state again."""
    yield robot.driver()
    commander.inject(name="clear")
    state = commander.lifecycle_state()
    if state == State.PRIMARY_STATE_ACTIVE:
        assert commander.change(Transition.TRANSITION_DEACTIVATE)
    if state != State.PRIMARY_STATE_UNCONFIGURED:
        assert commander.change(Transition.TRANSITION_CLEANUP)


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
        ({"use_sim_time": "true"}, "use_sim_time"),
        ({"limits.max_stroke_m": -1.0}, "limits.max_stroke_m"),
    ],
    ids=["port", "bus", "address", "id", "baud rate", "sign", "lengths", "time", "range"],
)
def test_a_wrong_configuration_is_reported_in_one_line(directory, capfd, change, expected):
    given = parameters(directory, autostart="true", **change)
    assert executables.driver_node(["driver_node", *ros_arguments("/other", **given)]) in (1, 2)
    output = capfd.readouterr().err
    assert re.search(f"^driver: .*{expected}", output, re.MULTILINE)
    assert "Traceback" not in output


# --- one driver for all ---------------------------------------------------------------------------------


SHAPED = {"contraction_share": 0.6, "profile": Gait.TRAPEZOID, "ramp_share": 0.2}


def test_a_gait_from_rest_to_figures(driver, commander, probe):
    feedback = []
    commander.activate()
    commander.wait_for_state(GaitState.IDLE, "activation")
    goal = commander.send(cycles=2, feedback=lambda m: feedback.append(m.feedback), **SHAPED)
    running = commander.wait_for_state(GaitState.RUNNING, "shaped gait")
    played = {name: getattr(running.gait, name) for name in SHAPED}
    assert played == pytest.approx(SHAPED)
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
    commander.wait_for_report("worm/driver: network", DiagnosticStatus.OK, "this machine only")
    for part in ("gait", "servo 1", "servo 11", "servo 12", "power sensor"):
        commander.wait_for_report(f"worm/driver: {part}", DiagnosticStatus.OK, "")
    timing = {value.key: value.value for value in latest()["worm/driver: timing"].values}
    assert {"p99_period_error_s", "missed_deadlines", "mean_period_s"} <= set(timing)


def test_goals_that_cannot_be_played_are_rejected_with_the_reason(driver, commander, probe):
    assert "not configured" in probe.rejection(commander.send())
    commander.activate()
    for gait, expected in (
        ({"stroke": math.nan}, "stroke: nan"),
        ({"stroke": 0.5}, "limits.max_stroke_m"),
        ({"profile": 7}, "profile"),
    ):
        assert expected in probe.rejection(commander.send(**gait))
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


def test_deactivation_brings_the_gait_to_rest_and_releases(driver, commander, probe, directory):
    run_into_a_gait(commander, probe)
    assert commander.change(Transition.TRANSITION_DEACTIVATE)
    assert commander.lifecycle_state() == State.PRIMARY_STATE_INACTIVE
    assert commander.change(Transition.TRANSITION_CLEANUP)
    assert torques(directory) == [0, 0, 0]
    commander.activate()


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


def test_a_driver_accepts_its_own_parameters_as_ros2_param_load_sets_them(
    driver, commander, probe, tmp_path
):
    """All parameters have their present values, including read-only ones and those that only a cleanup would permit.

    The parameter file was read at configure, and may be gone.
    """
    file = tmp_path / "parameters.yaml"
    file.write_text("rear_mass: 0.429\n")
    assert commander.set_parameter("parameter_file", str(file)).successful
    commander.activate()
    file.unlink()
    names = probe.call(ListParameters, "driver/list_parameters", ListParameters.Request())
    get = GetParameters.Request(names=names.result.names)
    values = probe.call(GetParameters, "driver/get_parameters", get).values
    assert len(values) == len(get.names) > 30
    own = [ParameterMessage(name=n, value=v) for n, v in zip(get.names, values, strict=True)]
    request = SetParameters.Request(parameters=own)
    results = probe.call(SetParameters, "driver/set_parameters", request).results
    assert [n for n, r in zip(get.names, results, strict=True) if not r.successful] == []
    file.write_text("rear_mass: 0.429\n")  # for the next configure of the shared driver


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
    processes._env["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "OFF"
    given = parameters(directory, autostart="true", port="/dev/none")
    second = processes.start_node("worm_driver", "driver_node", **given)
    assert second.wait(TIMEOUT_S) == 2
    second.wait_for_line(f"/worm has a driver already, process {driver.pid} ", TIMEOUT_S)
    assert commander.lifecycle_state() == State.PRIMARY_STATE_ACTIVE


def test_every_goal_and_every_stop_of_a_flood_is_answered(driver, commander, probe):
    commander.activate()
    before = len(driver.output().splitlines())
    goals = goal_client(probe)
    goal = RunGait.Goal(gait=Gait(stroke=0.05, frequency=0.4, direction=1), cycles=100)
    sent = [goals.send_goal_async(goal) for _ in range(150)]
    probe.wait_for(lambda: all(call.done() for call in sent), "answer to every goal")
    assert sum(call.result().accepted for call in sent) == 1
    assert len(driver.output().splitlines()) < before + 100
    client = probe.node.create_client(Trigger, "stop", qos_profile=EVERY_ANSWER)
    probe.meet("stop")
    calls = [client.call_async(Trigger.Request()) for _ in range(100)]
    probe.wait_for(lambda: all(call.done() for call in calls), "answer to every stop")
    assert all(call.result().success for call in calls)


def test_a_lower_limit_takes_effect_at_once_and_all_else_is_rejected_while_configured(
    driver, commander
):
    commander.activate()
    assert commander.set_parameter("limits.max_stroke_m", 0.02).successful
    assert "limits.max_stroke_m" in commander.probe.rejection(commander.send(stroke=0.03))
    for name, value, reason in (
        ("limits.max_stroke_m", 0.2, "lowered"),
        ("port", "/dev/other", "takes effect at configure"),
    ):
        rejected = commander.set_parameter(name, value)
        assert not rejected.successful
        assert reason in rejected.reason
    assert commander.change(Transition.TRANSITION_DEACTIVATE)
    assert commander.change(Transition.TRANSITION_CLEANUP)
    assert commander.set_parameter("limits.max_stroke_m", 0.09).successful


def test_a_silent_servo_is_a_fault_that_is_named_and_cleared(driver, commander):
    commander.activate()
    goal = commander.send(stroke=0.06, cycles=20)
    commander.wait_for_state(GaitState.RUNNING, "running gait")
    commander.inject(name="no_answer", target=1, duration=3600.0)
    answer = commander.result(goal)
    assert answer.status == ABORTED
    assert "fault: servo 1 has returned no state" in answer.result.message
    assert "servo 1" in commander.wait_for_state(GaitState.FAULT, "fault").message
    line = [line for line in driver.output().splitlines() if "FAULT: " in line][-1]
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


def test_a_transition_that_the_state_does_not_have_is_rejected_and_the_node_lives(
    driver, commander
):
    unconfigured = [Transition.TRANSITION_CLEANUP, Transition.TRANSITION_ACTIVE_SHUTDOWN, 99, 255]
    active = [Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE, 99, 255]
    for state, wrong in (
        (State.PRIMARY_STATE_UNCONFIGURED, unconfigured),
        (State.PRIMARY_STATE_ACTIVE, active),
    ):
        if wrong is active:
            commander.activate()
        assert not any(commander.change(number) for number in wrong)
        assert commander.lifecycle_state() == state
    driver.wait_for_line("there is no transition 99 .* only: ", TIMEOUT_S)
