# SPDX-License-Identifier: Apache-2.0
"""Late responses at every point of the driver's work: none is accepted, and none is reported as a fault of a servo."""

import re

import pytest
from driver_rig import Rig, moving

from worm_driver.driver_errors import DriverError
from worm_driver.gait.gait_player import Phase
from worm_driver.servos.state_reader import SILENT
from worm_driver.virtual_robot.wire.faults import make_fault

#: s, delays of responses: less than a wait, about one, a cycle, several
LATE = [0.003, 0.008, 0.012, 0.020, 0.040]
#: causes that must not be reported for a late response
FALSE = re.compile("input voltage|overheating|encoder|shock|overload|restarted|turn count|reports")


@pytest.mark.parametrize("count", [1, 5])
@pytest.mark.parametrize("late", LATE)
def test_a_home_with_late_answers_is_right_or_leaves_no_mark(late, count):
    """A stale offset that is read as a position moves the zero. With a mark, the next gait would then pay out cable."""
    for begin in range(0, 12, 3):
        rig = Rig()
        rig.run(0.05)
        fault = make_fault("late", count=count, value=late)
        rig.virtual.board.add(fault.delayed(rig.clock.now + begin * 0.012))
        try:
            rig.robot.home()
        except DriverError:
            assert not rig.cable.memory["led"]
            assert not rig.robot.actuators.homed
        if rig.cable.memory["led"]:
            zero = rig.cable._encoder.shaft(0)
            assert zero == pytest.approx(rig.cable.motor.position, abs=12)


def test_a_home_that_failed_is_not_activated_and_can_be_repeated():
    rig = Rig()
    rig.run(0.05)
    rig.inject("no_answer", target=1, duration=3.0)
    with pytest.raises(DriverError):
        rig.robot.home()
    rig.run(4.0)
    with pytest.raises(DriverError, match="turn count"):
        rig.robot.activate(rig.clock.now)
    rig.robot.home()
    rig.robot.activate(rig.clock.now)


@pytest.mark.parametrize("opened", [False, True])
@pytest.mark.parametrize("late", LATE)
def test_half_a_second_of_late_answers_is_forgotten(late, opened):
    """Also by a driver that was opened on late answers."""
    rig = Rig()
    rig.run(0.2)
    rig.inject("late", duration=0.5, value=late)
    if opened:
        try:
            rig = rig.restarted_driver()
        except DriverError:
            rig.run(1.0)
            rig = rig.restarted_driver()
    rig.run(0.65)
    assert SILENT not in rig.snapshots[-1].servos
    rig.robot.activate(rig.clock.now)
    assert rig.run(0.2).player.phase is Phase.IDLE


@pytest.mark.parametrize("duration", [0.02, 0.3])
@pytest.mark.parametrize("late", LATE)
def test_lateness_in_a_gait_is_called_lateness(late, duration):
    rig = moving()
    rig.inject("late", duration=duration, value=late)
    snapshot = rig.run(duration + 0.2)
    assert not FALSE.search(snapshot.player.message), snapshot.player.message
    if snapshot.player.phase is Phase.FAULT:
        assert "has returned no state" in snapshot.player.message


#: s, delays around the wait for an answer, the period of the cycle, and the timeout of a silent servo
LASTING = [0.006, 0.010, 0.012, 0.030, 0.060, 0.290]


@pytest.mark.parametrize("late", LASTING)
def test_answers_that_stay_late_are_called_late_at_configure_and_activate(late):
    rig = Rig()
    rig.run(0.1)
    rig.inject("late", duration=1e6, value=late)
    for deed in (rig.restarted_driver, lambda: rig.robot.activate(rig.clock.now)):
        with pytest.raises(DriverError) as caught:
            deed()
        silent = "nothing arrived for 2" in str(caught.value) and late > 0.2
        assert silent or re.search(r"servo 1\d? answers late \(\d+ ms after", str(caught.value))
        assert silent or "power" not in str(caught.value)
        assert "another position" not in str(caught.value)


@pytest.mark.parametrize("late", LASTING)
def test_answers_that_stay_late_are_called_late_in_a_gait(late):
    """A FAULT can report as late only what has arrived by then. Afterwards the diagnostics show the delay."""
    rig = moving()
    rig.inject("late", duration=1e6, value=late)
    fault = rig.run(1.0, until=lambda s: s.player.phase is Phase.FAULT).player.message
    assert "answers late" in fault or ("nothing arrived" in fault and late > 0.04)
    rig.run(0.5)
    assert rig.robot.problems
    for why in rig.robot.problems.values():
        delay = re.search(r"answers late \((\d+) ms", why)
        assert abs(int(delay[1]) - late * 1e3) <= 7
