# SPDX-License-Identifier: Apache-2.0
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from worm_driver.control.timing import DeadlineGrid, PeriodMeter, percentile


@given(st.floats(0.0, 1e6), st.floats(0.0, 100.0))
def test_the_next_deadline_is_on_the_grid_and_within_a_period(start, elapsed):
    grid = DeadlineGrid(start, 0.01)
    due = grid.next_after(start + elapsed)
    assert due > start + elapsed - 1e-9
    assert due - (start + elapsed) <= 0.01 + 1e-9
    steps = (due - start) / 0.01
    assert abs(steps - round(steps)) < 1e-6


def test_the_report_contains_period_error_and_misses():
    meter = PeriodMeter(0.01, window=100)
    time = 0.0
    for i in range(101):
        meter.begin(time, due=time - 0.001, skipped=1 if i == 50 else 0)
        meter.end(time + (0.015 if i == 49 else 0.004))
        time += 0.02 if i == 50 else 0.01
    report = meter.report()
    assert report.cycles == 101
    assert report.missed == 1
    assert report.max_error == pytest.approx(0.01)
    assert report.p99_error == pytest.approx(0.0, abs=1e-9)
    assert report.mean_period == pytest.approx(0.0101)


def test_the_report_distinguishes_a_late_start_from_a_long_cycle():
    meter = PeriodMeter(0.01)
    for i in range(100):
        due = 0.01 * i
        late = 0.003 if i % 10 == 0 else 0.0
        meter.begin(due + late, due, skipped=0)
        meter.end(due + late + 0.004)
    report = meter.report()
    assert report.p99_wake == pytest.approx(0.003)
    assert report.p99_cycle == pytest.approx(0.004)


def test_before_two_cycles_there_is_nothing_to_report():
    meter = PeriodMeter(0.01)
    meter.begin(0.0, 0.0, skipped=0)
    assert math.isnan(meter.report().p99_error)


def test_the_window_forgets():
    meter = PeriodMeter(0.01, window=10)
    for start in (0.0, 0.5):
        meter.begin(start, start, skipped=0)
        meter.end(start)
    for i in range(10):
        meter.begin(0.51 + 0.01 * i, 0.51 + 0.01 * i, skipped=0)
    assert meter.report().max_error == pytest.approx(0.0, abs=1e-9)


def test_percentile_is_a_value_of_the_list():
    assert percentile([3.0, 1.0, 2.0], 0.99) == 3.0
    assert percentile(range(1, 101), 0.99) == 99
