# SPDX-License-Identifier: Apache-2.0
"""Durations that are a fault, one cycle at a time. What servos on a bus do is in test_robot.py."""

import math
import re
from dataclasses import replace
from types import SimpleNamespace

import pytest

from worm_driver.control.actuators import CableLength
from worm_driver.control.driver_settings import DriverSettings
from worm_driver.control.fault_watch import FaultWatch, ServoHealth, crowding, fault_in_health
from worm_driver.gait.gait_player import PlayerState
from worm_driver.servos.registers import XM430_W350
from worm_driver.servos.state_reader import SILENT

ANSWER = replace(SILENT, effort=0.1)


class Watch:
    """Watch of two cable servos, on a clock that the test sets."""

    def __init__(self) -> None:
        self.now = 0.0
        cables = tuple(SimpleNamespace(number=number, model=XM430_W350) for number in (1, 2))
        self.lengths = {1: CableLength(-0.02, -0.02), 2: CableLength(-0.02, -0.02)}
        robot = SimpleNamespace(
            settings=DriverSettings(max_silence=0.035, max_servo_current=2.0),
            servos=cables,
            cables=cables,
            cable_lengths=lambda *_: self.lengths,
            contracted={},
            track=SimpleNamespace(lost={}),
            homed=True,
        )
        reader = SimpleNamespace(pop_suspect=lambda: None, problems={1: "sends garbled answers"})
        self._watch = FaultWatch(robot, reader, lambda: self.now, lambda: 12.34)
        self._watch.note_silence((ANSWER, ANSWER))

    def fault(self, first=ANSWER, second=ANSWER, elapsed: float = 0.01) -> str | None:
        self.now += elapsed
        self._watch.note_silence((first, second))
        return self._watch.fault((first, second), PlayerState())


def test_silence_adds_up_over_the_looks_and_ends_with_an_answer():
    watch = Watch()
    assert watch.fault(SILENT, elapsed=0.017) is None
    assert watch.fault(SILENT, elapsed=0.017) is None
    fault = watch.fault(SILENT, elapsed=0.002)
    assert re.search(r"servo 1\b.* 36 ms: it sends garbled answers", fault)
    assert watch.fault() is None


def test_the_drivers_own_lateness_is_no_silence_of_a_servo():
    watch = Watch()
    assert watch.fault(SILENT, elapsed=0.835) is None  # counts as 20 ms
    assert watch.fault(SILENT, elapsed=0.016) is not None


def test_a_busy_computer_is_named_as_a_possible_cause():
    assert "load 12.3 on 2 cores" in crowding(12.34, 2)
    assert crowding(1.9, 2) == ""


def test_a_peak_of_current_is_no_fault_but_a_blocked_cable_is():
    watch, strong = Watch(), replace(ANSWER, effort=-2.05)
    for _ in range(2):
        for _ in range(4):
            assert watch.fault(strong) is None
        assert watch.fault() is None
    for _ in range(4):
        assert watch.fault(strong) is None
    assert "servo 1 is beyond its limit" in watch.fault(strong)


def test_a_cable_that_does_not_follow_is_a_fault_of_its_servo():
    watch = Watch()
    for error in (0.016, -0.016, math.nan, 0.016, 0.016, 0.016, 0.016, 0.016):
        assert watch.fault() is None
        watch.lengths[2] = CableLength(-0.02 + error, -0.02)
    message = watch.fault()
    assert re.search("servo 2 is 16.0 mm off .* -4.0 mm instead of -20.0 mm", message)
    assert "limits.max_following_error_m (15 mm)" in message


@pytest.mark.parametrize(
    ("servo", "health", "expected"),
    [
        (1, ServoHealth(1, 1, 0b100000, 4), "servo 1 reports overload"),
        (1, ServoHealth(1, 1, 0, -1), "bus watchdog of servo 1 has expired"),
        (1, ServoHealth(0, 1, 0, 4), "program, as it has not restarted: its torque is off"),
        (1, ServoHealth(1, 0, 0, 4), "turn count is lost"),
        (1, ServoHealth(1, 1, 0, 0), "not restarted: its torque is on, without its bus watchdog"),
        (1, ServoHealth(0, 0, 0, 0), "has restarted: its torque is off, and its turn count is lost"),
        (1, ServoHealth(1, 1, 0, 4), None),
        # a fin has restarted only if its watchdog is reset, too; its LED does not matter
        (11, ServoHealth(0, 0, 0, 0), "servo 11 has restarted: its torque is off"),
        (11, ServoHealth(0, 1, 0, 4), "servo 11 was changed by another program"),
        (11, ServoHealth(1, 0, 0, 4), None),
    ],
)  # fmt: skip
def test_each_register_shows_its_fault(servo, health, expected):
    fault = fault_in_health(servo, health, is_cable=servo == 1)
    assert (fault is None) == (expected is None)
    assert expected is None or expected in fault
    assert servo == 1 or "turn count" not in str(fault)
