# SPDX-License-Identifier: Apache-2.0
"""Gaits on the virtual robot: what is refused, what moves, and that an interrupt stops the servos."""

import math

import pytest
from action_msgs.msg import GoalStatus
from harness import LATCHED, SERVOS, TIMEOUT_S, VirtualWorm
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from worm_msgs.action import RunGait
from worm_msgs.msg import Gait, GaitState, Power, Tracker

FAST = {"stroke": 0.07, "frequency": 0.4, "direction": Gait.FORWARD, "margin": 0.0}
OFF = dict.fromkeys(SERVOS, 0)


def goal(cycles=5, **changes):
    return RunGait.Goal(gait=Gait(**{**FAST, **changes}), cycles=cycles)


def start_running(worm: VirtualWorm):
    """Start a gait that would take a minute, and wait until the cable moves."""
    states = worm.probe.collect(GaitState, "gait_state", LATCHED)
    joints = worm.probe.collect(JointState, "joint_states")
    handle = worm.probe.send_goal(RunGait, "run_gait", goal(cycles=24))
    assert handle.accepted
    worm.probe.wait_for(
        lambda: states and states[-1].state == GaitState.RUNNING and states[-1].cycle >= 1,
        "running gait",
    )
    worm.probe.wait_for(lambda: abs(joints[-1].velocity[0]) > 0.5, "moving cable servo")
    return handle, states, joints


BAD_GAITS = [
    ({"stroke": math.nan}, "stroke"),
    ({"frequency": math.nan}, "frequency"),
    ({"frequency": -0.2}, "frequency"),
    ({"stroke": 0.0}, "stroke"),
    ({"stroke": 0.5}, "stroke"),
    ({"frequency": 4.0}, "frequency"),
    ({"direction": 3}, "direction"),
    ({"cycles": 0}, "cycles"),
]


def test_bad_gaits_are_refused_with_the_reason_and_the_robot_stays_as_it_was(worm):
    states = worm.probe.collect(GaitState, "gait_state", LATCHED)
    joints = worm.probe.collect(JointState, "joint_states")
    worm.probe.wait_for(
        lambda: states and states[-1].state == GaitState.IDLE and joints, "idle robot"
    )
    idle, before = len(states), joints[-1].position[0]

    for changes, reason in BAD_GAITS:
        handle = worm.probe.send_goal(RunGait, "run_gait", goal(**changes))
        answer = worm.probe.result(handle.get_result_async(), "result")
        assert answer.status == GoalStatus.STATUS_ABORTED, changes
        assert not answer.result.success, changes
        assert reason in answer.result.message, changes

    seen = len(joints)
    worm.probe.wait_for(lambda: len(joints) > seen + 20, "joint states after the refusals")
    assert joints[-1].position[0] == pytest.approx(before, abs=0.01)
    assert states[idle:] == []


def test_a_gait_moves_the_robot_and_ends_at_rest(worm):
    tracker = worm.probe.collect(Tracker, "tracker")
    power = worm.probe.collect(Power, "power")
    handle = worm.probe.send_goal(RunGait, "run_gait", goal(cycles=3))
    result = worm.probe.result(handle.get_result_async(), "result", 60.0).result
    assert result.success, result.message
    assert result.cycles_completed == 3
    positions = [m.rear_position for m in tracker if math.isfinite(m.rear_position)]
    assert positions[-1] - positions[0] > 0.05
    assert max(m.power for m in power if m.status == Power.VALID) > 5.0


def test_the_stop_service_stops_at_once_and_says_so(worm):
    handle, states, joints = start_running(worm)
    assert worm.probe.call(Trigger, "stop", Trigger.Request()).success
    answer = worm.probe.result(handle.get_result_async(), "result")
    assert not answer.result.success
    assert "stop" in answer.result.message
    worm.probe.wait_for(lambda: abs(joints[-1].velocity[0]) < 0.05, "standing cable servo")
    assert states[-1].state != GaitState.RUNNING


def test_an_interrupt_of_the_driver_stops_the_servos(worm):
    start_running(worm)
    driver = worm.processes.processes["driver"]
    driver.interrupt()
    assert driver.wait(TIMEOUT_S) == 0
    assert worm.torques() == OFF


def test_a_killed_driver_leaves_servos_that_stop_by_themselves(worm):
    start_running(worm)
    tracker = worm.probe.collect(Tracker, "tracker")
    driver = worm.processes.processes["driver"]
    driver.kill()
    driver.wait(TIMEOUT_S)
    # the bus watchdog of the servos: the body comes to rest with nobody there
    worm.probe.wait_for(
        lambda: len(tracker) > 60 and spread(tracker[-15:]) < 0.002, "standing body"
    )


def spread(samples):
    lengths = [
        m.front_position - m.rear_position
        for m in samples
        if math.isfinite(m.front_position - m.rear_position)
    ]
    return max(lengths) - min(lengths) if lengths else math.inf


@pytest.mark.parametrize("name", ["twin", "optimizer"])
def test_an_interrupt_of_another_node_ends_it_and_leaves_the_gait_alone(worm, name):
    worm.start(name)
    _, states, _ = start_running(worm)
    process = worm.processes.processes[name]
    worm.probe.wait_for(lambda: name in worm.probe.node.get_node_names(), f"node {name}")
    process.interrupt()
    assert process.wait(TIMEOUT_S) == 0
    cycle = states[-1].cycle
    worm.probe.wait_for(lambda: states[-1].cycle > cycle, "next cycle")
    assert states[-1].state == GaitState.RUNNING


def test_a_robot_that_disappears_is_a_fault(worm):
    handle, states, _ = start_running(worm)
    robot = worm.processes.processes["virtual_robot"]
    robot.interrupt()
    assert robot.wait(TIMEOUT_S) == 0
    worm.probe.wait_for(lambda: states[-1].state == GaitState.FAULT, "fault")
    answer = worm.probe.result(handle.get_result_async(), "result")
    assert answer.status == GoalStatus.STATUS_ABORTED
    driver = worm.processes.processes["driver"]
    driver.interrupt()
    assert driver.wait(TIMEOUT_S) == 0
