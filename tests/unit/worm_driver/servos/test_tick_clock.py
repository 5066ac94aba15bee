# SPDX-License-Identifier: Apache-2.0
import pytest
from hypothesis import given
from hypothesis import strategies as st

from worm_driver.servos import tick_clock
from worm_driver.servos.tick_clock import RESOLUTION, WRAP_S, TickClock, age, begin, jump, update

#: s, from the creation of a response to its last byte
WAY = 0.001


def tick(time: float) -> float:
    return int(time * 1000) % 32768 / 1000


def answered(clock: TickClock, made: float, late: float = 0.0) -> TickClock:
    """Return the clock after a response that was created at a time and received late."""
    return update(clock, tick(made), made + WAY + late)


@given(st.floats(0.0, 1e5), st.floats(0.0, 0.2), st.floats(0.0, 0.25))
def test_a_late_answer_is_older_than_its_question_by_what_it_is_late(start, gap, late):
    clock = begin(tick(start), start + WAY)
    request_time = start + gap + late
    assert age(clock, tick(start + gap), request_time) == pytest.approx(late - WAY, abs=0.0011)


def test_the_wrap_is_no_jump():
    clock = begin(tick(32.760), 32.761)
    assert abs(jump(clock, tick(32.770), 32.771)) < 0.002


def test_slow_answers_do_not_hide_a_late_one():
    """Responses that took 4 ms leave the fastest one as the reference, except for the drift of the clocks."""
    clock = begin(tick(0.0), WAY)
    for i in range(1, 101):
        clock = answered(clock, i * 0.01, late=0.003)
    assert age(clock, tick(1.01 - 0.010), 1.01) > RESOLUTION


@pytest.mark.parametrize("rate", [1.0005, 0.9995])
def test_a_drifting_clock_is_followed(rate):
    clock = begin(0.0, WAY)
    for i in range(1, 100_000):
        request_time = i * 0.01
        shown = tick(request_time * rate)
        clock = update(clock, shown, request_time + WAY)
        assert age(clock, shown, request_time) <= RESOLUTION
        assert age(clock, shown, request_time + 0.01) > RESOLUTION


def test_a_restart_is_further_off_than_any_late_answer():
    clock = begin(tick(100.0), 100.001)
    assert abs(jump(clock, tick(0.25), 100.501)) >= tick_clock.RESTART


@given(
    st.lists(st.tuples(st.floats(0.0, 0.05), st.floats(0.0, 0.25)), min_size=1, max_size=50),
    st.floats(0.0, 1e3),
)
def test_no_late_answers_make_a_later_good_one_look_old(answers, start):
    """However the clock was updated before, a response that was created after its request is accepted."""
    clock, now = None, start
    for gap, late in answers:
        now += gap
        received = now + WAY + late
        clock = begin(tick(now), received) if clock is None else update(clock, tick(now), received)
    request_time = now + 0.3
    clock = answered(clock, request_time)
    assert age(clock, tick(request_time), request_time) <= RESOLUTION
    assert 0.0 <= clock.lead < WRAP_S
