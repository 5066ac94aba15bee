# SPDX-License-Identifier: Apache-2.0
"""The end of the driver, on the virtual robot's bytes: how a stop, a fault or an operator affects the torque."""

import math
import re
from dataclasses import replace

import pytest
from driver_rig import CABLE, Rig, idle, moving, settings

from worm_driver.driver_errors import ConfigurationError, RejectedError
from worm_driver.gait.gait_player import Phase


def closing(passed: float) -> Rig:
    """Return a driver that is shut down in the middle of a stroke, after a time (s) of its return to rest."""
    rig = moving()
    rig.loop.shutdown("the driver ends")
    if passed:
        rig.run(passed)
    return rig


def ended(rig: Rig, longest: float = 10.0) -> list[str]:
    """Return the problems reported when the driver's thread has ended."""
    end = rig.clock.now + longest
    while not rig.ended:
        rig.run(rig.settings.period)
        assert rig.clock.now < end
    return rig.end()


def told(message: str) -> float:
    """Return the contraction (m) that a message names."""
    return float(re.findall(r"contracted by ([\d.]+) mm", message)[0]) * 1e-3


def stop(rig: Rig) -> None:
    rig.loop.submit(lambda now: rig.robot.stop(now, "stop"), lifetime=math.inf)


def left_contracted() -> Rig:
    """Return a driver whose end left the robot contracted, with its torque on."""
    rig = closing(0.3)
    stop(rig)
    ended(rig)
    assert rig.contraction > 0.003
    return rig


@pytest.mark.parametrize("passed", [0.0, 0.3, 0.8])
def test_a_stop_at_any_time_of_the_return_leaves_the_torque_on(passed):
    rig = closing(passed)
    stop(rig)
    (problem,) = ended(rig)
    held = rig.contraction
    assert held > 0.003
    assert told(problem) == pytest.approx(held, abs=1e-4)
    assert rig.cable.memory["torque_enable"] == 1
    rig.clock.now += 1.0
    rig.advance(rig.clock.now)  # the bus watchdog has fired by now
    assert rig.contraction == pytest.approx(held, abs=1e-4)


def test_the_next_driver_brings_a_robot_to_rest_that_was_left_so():
    again = left_contracted().restarted_driver()
    again.run(0.1)
    left = again.run(0.02).player.message
    assert "torque" in left
    assert told(left) == pytest.approx(again.contraction, abs=1e-4)
    again.robot.activate(again.clock.now)
    assert again.run(0.02).player.message == ""
    again.deactivate()
    assert again.contraction == pytest.approx(0.0, abs=1e-3)
    assert again.cable.memory["torque_enable"] == 0


def test_a_driver_with_other_limits_does_not_release_a_robot_that_was_left_contracted():
    """The current limit of the servo could only be changed without torque."""
    rig = left_contracted()
    held = rig.contraction
    other = replace(rig.settings, home_at_start=False, max_servo_current=1.9)
    with pytest.raises(ConfigurationError, match=r"current_limit is 2\.2"):
        rig.restarted_driver(other)
    assert rig.cable.memory["torque_enable"] == 1
    assert rig.contraction == pytest.approx(held, abs=1e-4)
    again = rig.restarted_driver()
    again.robot.activate(again.clock.now)
    again.deactivate()
    assert rig.restarted_driver(other).robot.actuators.left_on == ""


@pytest.mark.parametrize(
    ("register", "value", "wanted"), [("led", 0, 1), ("operating_mode", 3, 4), ("drive_mode", 1, 0)]
)
def test_a_torque_at_an_unknown_position_is_not_released(register, value, wanted):
    rig = left_contracted()
    rig.cable.memory[register] = value
    with pytest.raises(ConfigurationError) as caught:
        rig.restarted_driver()
    registers = re.findall(r"\w+ \d+ instead of \d+", str(caught.value))
    assert registers == [f"{register} {value} instead of {wanted}"]
    assert rig.cable.memory["torque_enable"] == 1


def test_a_reboot_of_a_servo_that_was_left_with_its_torque_permits_a_home():
    rig = left_contracted().restarted_driver(settings(home_at_start=False))
    assert rig.robot.actuators.left_on
    rig.inject("overload", target=CABLE)
    rig.run(0.5)
    assert rig.robot.reboot() == (CABLE,)
    rig.run(1.0)
    assert rig.robot.actuators.left_on == ""
    rig.robot.home()
    rig.robot.activate(rig.clock.now)


def test_a_stop_that_comes_when_it_is_at_rest_does_not_keep_the_torque():
    rig = closing(0.0)
    while not rig.ended:
        rig.run(rig.settings.period)
    stop(rig)
    assert rig.end() == []
    assert rig.cable.memory["torque_enable"] == 0


def latched(rig: Rig) -> Rig:
    """Return the same driver half a second after an emergency stop."""
    rig.robot._why_not_start = lambda: "the emergency stop is on"
    rig.robot.stop(rig.clock.now, "the emergency stop is on")
    rig.run(0.5)
    return rig


def test_while_nothing_may_start_it_is_not_brought_to_rest_either():
    rig = moving()
    held = latched(rig).contraction
    rig.loop.shutdown("the driver ends")
    assert ended(rig) != []
    assert rig.contraction == pytest.approx(held, abs=1e-3)
    assert rig.cable.memory["torque_enable"] == 1


def test_during_an_emergency_stop_a_robot_that_is_not_contracted_is_released_without_a_motion():
    rig = idle()
    latched(rig)
    rig.goals.clear()
    rig.robot.ramp_to_rest(rig.clock.now, "deactivated")
    assert rig.robot.released
    assert rig.goals == []
    assert rig.robot.release() == []
    assert rig.torques == [0, 0, 0]


def test_in_fault_a_person_releases_the_torque_also_during_an_emergency_stop():
    rig = moving()
    rig.inject("no_answer", target=11, duration=1e6)
    rig.run(1.0, until=lambda s: s.player.phase is Phase.FAULT)
    latched(rig)
    rig.robot.ramp_to_rest(rig.clock.now, "deactivated")
    assert rig.robot.released


@pytest.mark.parametrize("shuts_down", [False, True])
def test_a_fault_on_the_way_to_rest_releases_no_torque(shuts_down):
    """Only a deactivation that is requested in FAULT may let a contracted robot spring back."""
    rig = closing(0.2) if shuts_down else moving()
    if not shuts_down:
        rig.robot.ramp_to_rest(rig.clock.now, "deactivated")
        rig.run(0.2)
    rig.inject("no_answer", target=11, duration=1e6)
    rig.run(1.0, until=lambda s: s.player.phase is Phase.FAULT)
    assert rig.contraction > 0.01
    assert rig.cable.memory["torque_enable"] == 1
    assert (rig.robot.released, rig.robot.holding) == (False, True)
    if shuts_down:
        assert ended(rig) != []
        assert rig.cable.memory["torque_enable"] == 1
        return
    rig.robot.ramp_to_rest(rig.clock.now, "deactivated again")
    assert rig.robot.released


def test_a_deactivation_of_a_robot_that_would_not_spring_back_needs_no_second_one():
    rig = idle()
    rig.robot.ramp_to_rest(rig.clock.now, "deactivated")
    rig.inject("no_answer", duration=1e6)
    rig.run(1.0, until=lambda s: s.player.phase is Phase.FAULT)
    assert rig.robot.released


def test_no_torque_is_switched_on_while_it_shuts_down():
    rig = Rig()
    rig.run(0.1)
    rig.loop.shutdown("the driver ends")
    activation = rig.loop.submit(lambda now: rig.robot.activate(now))
    rig.run(rig.settings.period)
    with pytest.raises(RejectedError, match="shuts down"):
        activation.result(0)
    assert rig.ended
    assert rig.torques == [0, 0, 0]


def test_no_gait_begins_while_it_shuts_down():
    rig = closing(0.2)
    with pytest.raises(RejectedError, match="shuts down"):
        rig.start()
