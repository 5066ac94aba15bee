# SPDX-License-Identifier: Apache-2.0
import math
import re

import pytest

from worm_driver.control import supervision
from worm_driver.control.supervision import (
    CableLength,
    Counts,
    ServoHealth,
    fault_in_counts,
    fault_in_health,
)
from worm_msgs.driver_file import DriverFile

LIMITS = DriverFile(max_silence=0.035, max_servo_current=2.0, max_following_error=0.015)


def test_silence_adds_up_over_the_looks_and_ends_with_an_answer():
    counts = supervision.silence(Counts(), [1], 0.017)
    counts = supervision.silence(counts, [1], 0.017)
    problems = {1: "does not answer intact"}
    assert fault_in_counts(counts, LIMITS, problems) is None
    counts = supervision.silence(counts, [1], 0.002)
    fault = fault_in_counts(counts, LIMITS, problems)
    assert re.search(r"servo 1\b.* 36 ms: .*does not answer intact", fault)
    load_note = supervision.crowding(12.34, 2)
    assert fault_in_counts(counts, LIMITS, problems, load_note) == fault + load_note
    assert "load 12.3 on 2 cores" in load_note
    assert supervision.crowding(1.9, 2) == ""
    counts = supervision.silence(counts, [], 0.02)
    assert fault_in_counts(counts, LIMITS, problems) is None


def test_the_drivers_own_lateness_is_no_silence_of_a_servo():
    assert supervision.watched_time(0.014, 0.01) == 0.014
    assert supervision.watched_time(0.835, 0.01) == 0.02


def test_a_peak_of_current_is_no_fault_but_a_blocked_cable_is():
    counts = Counts()
    levels = {1: 2.0, 2: 0.9}
    for _ in range(4):
        counts = supervision.overload(counts, {1: -2.5, 2: 0.8}, levels)
    peak = supervision.overload(counts, {1: 1.0}, levels)
    assert fault_in_counts(peak, LIMITS, {}) is None
    blocked = supervision.overload(counts, {1: 2.5}, levels)
    assert "servo 1 is beyond its limit" in fault_in_counts(blocked, LIMITS, {})


def test_a_cable_that_does_not_follow_is_a_fault_of_its_servo():
    counts = Counts()
    for error in (0.016, -0.016, math.nan, 0.016, 0.016, 0.016, 0.016, 0.016):
        assert fault_in_counts(counts, LIMITS, {}) is None
        cables = {1: CableLength(-0.02, -0.02), 2: CableLength(-0.02 + error, -0.02)}
        counts = supervision.following(counts, cables, LIMITS)
    message = fault_in_counts(counts, LIMITS, {})
    assert re.search("servo 2 is 16.0 mm off .* -4.0 mm instead of -20.0 mm", message)
    assert "limits.max_following_error_m (15 mm)" in message


@pytest.mark.parametrize(
    ("health", "expected"),
    [
        (ServoHealth(1, 1, 0b100000, 4), "reports overload"),
        (ServoHealth(1, 1, 0, -1), "bus watchdog of servo 1 has expired"),
        (ServoHealth(0, 1, 0, 4), "another program, as it has not restarted: its torque is off"),
        (ServoHealth(1, 0, 0, 4), "turn count is lost"),
        (ServoHealth(1, 1, 0, 0), "not restarted: its torque is on, without its bus watchdog"),
        (ServoHealth(0, 0, 0, 0), "has restarted: its torque is off, and its turn count is lost"),
    ],
)
def test_each_register_shows_its_fault(health, expected):
    assert expected in fault_in_health(1, health, is_cable=True)


@pytest.mark.parametrize(
    ("health", "restarted"), [(ServoHealth(0, 0, 0, 0), True), (ServoHealth(0, 1, 0, 4), False)]
)
def test_a_fin_has_restarted_only_if_its_watchdog_is_reset_too(health, restarted):
    found = fault_in_health(11, health, is_cable=False)
    assert ("servo 11 has restarted" in found) is restarted
    assert "turn count" not in found


def test_a_healthy_servo_has_no_fault_and_a_fins_led_does_not_matter():
    assert fault_in_health(1, ServoHealth(1, 1, 0, 4), is_cable=True) is None
    assert fault_in_health(11, ServoHealth(1, 0, 0, 4), is_cable=False) is None
