# SPDX-License-Identifier: Apache-2.0
import pytest
from hypothesis import given
from hypothesis import strategies as st

from worm_driver.servos import tick_clock
from worm_driver.servos.tick_clock import WRAP_S, begin, lag, update


def tick(time: float) -> float:
    return int(time * 1000) % 32768 / 1000


@given(st.floats(0.0, 1e5), st.floats(0.0, 0.2), st.floats(0.0, 0.9))
def test_a_late_answer_lags_by_what_it_is_late(start, gap, late):
    clock = begin([(start, tick(start))])
    asked = start + gap + late
    assert lag(clock, asked, tick(start + gap)) == pytest.approx(late, abs=0.0021)


def test_the_wrap_is_no_jump():
    clock = begin([(32.760, tick(32.760))])
    assert abs(lag(clock, 32.770, tick(32.770))) < 0.002


def test_slow_answers_do_not_hide_a_late_one():
    """Answers that took 4 ms leave the promptest as the measure, but for what the clocks may drift."""
    clock = begin([(0.0, tick(0.0))])
    for i in range(1, 101):
        clock = update(clock, i * 0.01, tick(i * 0.01 + 0.004))
    assert lag(clock, 1.01, tick(1.01 - 0.010)) == pytest.approx(0.010, abs=0.0035)


def test_a_drifting_clock_is_followed():
    clock = begin([(0.0, 0.0)])
    for i in range(1, 100_000):
        asked = i * 0.01
        clock = update(clock, asked, tick(asked * 1.0005))
        assert abs(lag(clock, asked, tick(asked * 1.0005))) < 0.002


def test_a_restart_is_further_off_than_any_late_answer():
    clock = begin([(100.0, tick(100.0))])
    assert abs(lag(clock, 100.5, tick(0.25))) >= tick_clock.RESTART


def test_the_first_answers_count_by_the_promptest():
    slow_first = [(0.0, 0.005), (0.01, 0.010), (0.02, 0.021)]
    assert begin(slow_first).delay % WRAP_S == pytest.approx(0.0, abs=1e-4)
