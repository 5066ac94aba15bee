# SPDX-License-Identifier: Apache-2.0
import math

import pytest

from worm_driver.control import supervision
from worm_driver.control.supervision import Counts, Health, Limits, fault_in_counts, fault_in_health

LIMITS = Limits(max_silence=0.035, max_current=2.0, following_error=0.015)


def test_silence_counts_from_the_first_cycle_and_ends_with_an_answer():
    counts = supervision.silence(Counts(), [1], 10.0)
    counts = supervision.silence(counts, [1], 10.02)
    assert fault_in_counts(counts, LIMITS, 10.03, {}) is None
    problems = {1: "does not answer intact"}
    fault = fault_in_counts(counts, LIMITS, 10.036, problems)
    assert fault == "servo 1 gives no state for 36 ms: it does not answer intact"
    counts = supervision.silence(counts, [], 10.04)
    assert fault_in_counts(counts, LIMITS, 20.0, problems) is None


def test_a_peak_of_current_is_no_fault_but_a_blocked_cable_is():
    counts = Counts()
    levels = {1: 2.0, 2: 0.9}
    for _ in range(4):
        counts = supervision.overload(counts, {1: -2.5, 2: 0.8}, levels)
    peak = supervision.overload(counts, {1: 1.0}, levels)
    assert fault_in_counts(peak, LIMITS, 0.0, {}) is None
    blocked = supervision.overload(counts, {1: 2.5}, levels)
    assert "servo 1 is beyond its limit" in fault_in_counts(blocked, LIMITS, 0.0, {})


def test_a_cable_that_does_not_follow_is_a_fault():
    counts = Counts()
    for error in (0.016, -0.016, math.nan, 0.016, 0.016, 0.016):
        counts = supervision.following(counts, error, LIMITS)
        assert fault_in_counts(counts, LIMITS, 0.0, {}) is None
    for _ in range(2):
        counts = supervision.following(counts, 0.016, LIMITS)
    assert "15 mm off its command" in fault_in_counts(counts, LIMITS, 0.0, {})


@pytest.mark.parametrize(
    ("health", "words"),
    [
        (Health(1, 1, 0b100000, 4), "reports overload"),
        (Health(1, 1, 0, -1), "bus watchdog of servo 1 has expired"),
        (Health(0, 1, 0, 4), "has restarted"),
        (Health(1, 0, 0, 4), "turn count is lost"),
        (Health(1, 1, 0, 0), "has restarted"),
    ],
)
def test_each_register_tells_its_fault(health, words):
    assert words in fault_in_health(1, health, is_cable=True)


def test_a_healthy_servo_has_no_fault_and_a_fins_led_does_not_matter():
    assert fault_in_health(1, Health(1, 1, 0, 4), is_cable=True) is None
    assert fault_in_health(11, Health(1, 0, 0, 4), is_cable=False) is None


@pytest.mark.parametrize("turns", [-2, -1, 1, 3])
def test_a_folded_turn_count_is_no_motion(turns):
    assert supervision.turn_count_jumped(100, 100 + turns * 4096, 0.01, 4.8)


def test_the_fastest_motion_is_no_fold_even_after_lost_cycles():
    per_second = 4.8 / (2 * math.pi) * 4096
    for elapsed in (0.01, 0.05, 0.5):
        moved = round(per_second * elapsed)
        assert not supervision.turn_count_jumped(0, moved, elapsed, 4.8)
