# SPDX-License-Identifier: Apache-2.0
import itertools
from dataclasses import replace

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from worm_driver.driver_errors import RejectedError
from worm_driver.gait import gait_player
from worm_driver.gait.gait_player import Ending, Observation, Phase, PlayerSettings, PlayerState
from worm_msgs.gait import Gait, Profile

SETTINGS = PlayerSettings()
GAIT = Gait(0.07, 0.4)
READY = Observation((), idle_samples=100)
DT = 0.01


def play(state, now, duration, seen=READY, until=None):
    """Return the states every 10 ms for a duration (s), or until a condition holds."""
    states = []
    for i in range(1, round(duration / DT) + 1):
        state = gait_player.step(state, now + i * DT, seen, SETTINGS)
        states.append((now + i * DT, state))
        if until is not None and until(state):
            break
    return states


def started(gait=GAIT, cycles=5):
    return gait_player.start(PlayerState(), 0.0, gait, cycles)


def running(gait=GAIT, cycles=5):
    return play(started(gait, cycles), 0.0, 10.0, until=lambda s: s.phase is Phase.RUNNING)[-1]


def test_the_rest_waits_for_ten_idle_samples():
    state = started()
    few = Observation((), idle_samples=9)
    states = play(state, 0.0, 2.5, seen=few)
    assert states[-1][1].phase is Phase.RESTING
    now, state = states[-1]
    assert play(state, now, DT)[-1][1].phase is Phase.RUNNING
    # it does not wait for ever
    assert play(state, now, 2.0, seen=few)[-1][1].phase is Phase.RUNNING


def test_the_rest_waits_for_the_tracker_but_not_for_ever():
    state = started()
    blind = Observation((), idle_samples=100, tracker_ready=False)
    states = play(state, 0.0, 10.0, seen=blind, until=lambda s: s.phase is Phase.RUNNING)
    assert states[-1][0] - states[-1][1].run.rest_start >= SETTINGS.rest_timeout - DT
    assert states[-1][1].message == "the tracker did not see the robot at rest before the gait"
    assert play(state, 0.0, 10.0, until=lambda s: s.phase is Phase.RUNNING)[-1][1].message == ""


SHAPED = Gait(
    0.06, 0.4, pretension=0.012, contraction_share=0.6, profile=Profile.TRAPEZOID, ramp_share=0.2
)
GAITS = st.builds(
    Gait,
    st.floats(0.02, 0.07),
    st.floats(0.1, 0.4),
    pretension=st.one_of(st.just(0.0), st.floats(0.0, 0.02)),
    contraction_share=st.floats(0.2, 0.8),
    profile=st.sampled_from([Profile.COSINE, Profile.TRAPEZOID]),
    ramp_share=st.floats(0.1, 0.5),
)


@given(GAITS, st.integers(1, 4))
@example(Gait(0.0625, 0.359375, pretension=0.000726), 1)  # the run ends between two steps
def test_a_run_ends_at_rest_after_its_cycles_and_never_jumps(gait, cycles):
    state = started(gait, cycles)
    states = play(state, 0.0, 60.0, until=lambda s: s.phase is Phase.IDLE)
    final = states[-1][1]
    assert final.length_change == 0.0
    assert final.run.ending is Ending.COMPLETED
    assert final.run.cycles_completed(1e3) == cycles
    assert final.run.end == pytest.approx(final.run.onset + cycles / gait.frequency)
    lengths = [0.0, *(s.length_change for _, s in states)]
    phases = [Phase.RETURNING, *(s.phase for _, s in states)]
    for (before, after), phase in zip(itertools.pairwise(lengths), phases, strict=False):
        speed = gait.peak_speed if phase is Phase.RUNNING else SETTINGS.return_speed
        assert abs(after - before) <= speed * DT * 1.01 + gait_player.REST_TOLERANCE
    resting = {s.length_change for _, s in states if s.phase is Phase.RESTING}
    assert resting == {-gait.pretension}


def test_the_cable_is_tensioned_once_the_fins_are_set_and_rests_before_the_gait():
    state = started(SHAPED, 1)
    moving = Observation((11, 12), idle_samples=0)
    waiting = play(state, 0.0, 1.0, seen=moving)
    assert {s.length_change for _, s in waiting} == {0.0}
    now, state = waiting[-1]
    states = play(state, now, 10.0, until=lambda s: s.phase is Phase.RUNNING)
    order = [phase for phase, _ in itertools.groupby(s.phase for _, s in states)]
    tensioned = [Phase.TENSIONING, Phase.FLIPPING, Phase.RESTING, Phase.RUNNING]
    assert order == tensioned
    reached = next(t for t, s in states if s.length_change == -SHAPED.pretension)
    assert states[-1][1].run.rest_start >= reached + SETTINGS.settle_time - DT
    assert states[-1][1].run.onset - states[-1][1].run.rest_start >= SETTINGS.rest_duration - DT


@given(st.floats(0.0, 12.0), st.sampled_from(["cancel", "release", "stop", "fault"]))
def test_at_any_time_of_a_shaped_gait_it_comes_to_rest_or_holds(when, deed):
    state = started(SHAPED, 2)
    states = play(state, 0.0, when) or [(0.0, state)]
    now, state = states[-1]
    here, ended = state.length_change, state.run.ending
    if deed == "cancel":
        state = gait_player.cancel(state, now, "cancelled")
    elif deed == "release":
        state = gait_player.return_to_rest(state, now, "deactivated")
    elif deed == "stop":
        state = gait_player.stop(state, now, "asked to")
    else:
        state = gait_player.fault(state, now, "a servo is gone")
    after = play(state, now, 10.0)
    lengths = [here, *(s.length_change for _, s in after)]
    if deed in ("cancel", "release"):
        assert after[-1][1].phase is Phase.IDLE
        assert lengths[-1] == 0.0
        assert after[-1][1].run.ending is not None
        fastest = SHAPED.peak_speed if deed == "cancel" else SETTINGS.return_speed
        steps = [abs(after - before) for before, after in itertools.pairwise(lengths)]
        assert max(steps) <= max(fastest * DT * 1.01, gait_player.REST_TOLERANCE)
    else:
        assert set(lengths) == {here}
    expected = {"cancel": Ending.CANCELLED, "fault": Ending.FAILED}.get(deed, Ending.STOPPED)
    assert after[-1][1].run.ending is (expected if ended is None else ended)


def test_a_run_may_begin_while_the_cable_still_returns_from_the_one_before():
    now, state = running(SHAPED, 1)
    now, state = play(state, now, 10.0, until=lambda s: s.phase is Phase.RETURNING)[-1]
    now, state = play(state, now, 0.1)[-1]
    assert -SHAPED.pretension < state.length_change < 0.0
    once = play(state, now, 5.0, until=lambda s: s.length_change == 0.0)
    state = gait_player.start(state, now, GAIT, 1)
    again = play(state, now, 5.0, until=lambda s: s.length_change == 0.0)
    assert [s.length_change for _, s in again] == [s.length_change for _, s in once]
    assert again[-1][1].run.number == 2


def test_a_late_step_does_not_make_the_tensioning_faster():
    state = started(SHAPED, 1)
    now, state = play(state, 0.0, 5.0, until=lambda s: s.phase is Phase.TENSIONING)[-1]
    now, state = play(state, now, 0.1)[-1]
    late = gait_player.step(state, now + 0.06, READY, SETTINGS)
    assert abs(late.length_change - state.length_change) <= SETTINGS.return_speed * DT * 1.01


@given(st.lists(st.tuples(st.integers(1, 60), st.floats(0.005, 0.2)), min_size=1, max_size=5))
@example([(110, 0.05), (1, 0.02)])
def test_another_speed_during_a_return_to_rest_does_not_make_the_cable_jump(changes):
    now, state = running()
    state = replace(gait_player.stop(state, now, "asked to"), length_change=-0.07)
    state = gait_player.return_to_rest(state, now, "deactivated")
    speeds = [speed for steps, speed in changes for _ in range(steps)]
    for speed in [*speeds, *itertools.repeat(changes[-1][1], 10_000)]:
        now, before = now + DT, state
        state = gait_player.step(state, now, READY, replace(SETTINGS, return_speed=speed))
        assert 0.0 <= state.length_change - before.length_change <= speed * DT * 1.01
        if state.phase is Phase.IDLE:
            break
    assert gait_player.at_rest(state)


@given(st.floats(0.05, 11.0))
def test_cancel_ends_at_the_next_point_of_rest(when):
    now, state = running(cycles=5)
    onset = state.run.onset
    states = play(state, now, when)
    now, state = states[-1]
    if state.run.ending is not None:
        return
    cycle = state.run.cycle(now)
    state = gait_player.cancel(state, now, "cancelled")
    assert state.phase is Phase.STOPPING
    final = play(state, now, 3.0)[-1][1]
    assert final.run.ending is Ending.CANCELLED
    assert final.length_change == 0.0
    assert final.run.end == pytest.approx(onset + cycle / 0.4)


def test_cancel_at_rest_ends_at_once():
    state = started()
    now, state = play(state, 0.0, 0.8)[-1]
    assert state.phase is Phase.RESTING
    state = gait_player.cancel(state, now, "cancelled")
    assert (state.phase, state.run.ending) == (Phase.IDLE, Ending.CANCELLED)
    assert state.run.cycles_completed(now) == 0


@pytest.mark.parametrize("cancelled", [False, True])
def test_a_return_lasts_until_the_encoders_show_the_cable_at_rest(cancelled):
    now, state = running()
    state = replace(gait_player.stop(state, now, "asked to"), length_change=-0.02)
    state = gait_player.start(state, now, GAIT, 1)
    if cancelled:
        state = gait_player.cancel(state, now, "cancelled")
    returning = state.phase
    now, state = play(state, now, 5.0, seen=replace(READY, at_rest=False))[-1]
    assert (state.phase, state.length_change) == (returning, 0.0)
    now, state = play(state, now, DT)[-1]
    assert state.phase is (Phase.IDLE if cancelled else Phase.FLIPPING)


def test_a_fault_holds_and_rejects_until_the_next_activation():
    now, state = running()
    state = gait_player.fault(state, now, "servo 1 is gone")
    assert state.run.ending is Ending.FAILED
    assert play(state, now, 1.0)[-1][1].length_change == state.length_change
    with pytest.raises(RejectedError, match="servo 1 is gone"):
        gait_player.start(state, now, GAIT, 5)
    assert gait_player.fault(state, now, "another").message == "servo 1 is gone"
    assert gait_player.stop(state, now, "stop").phase is Phase.FAULT


def test_fins_that_do_not_arrive_are_a_fault():
    state = gait_player.start(PlayerState(), 0.0, Gait(0.07, 0.4, -1), 1)
    moving = Observation((11, 12), idle_samples=0)
    final = play(state, 0.0, 4.0, seen=moving)[-1][1]
    assert final.phase is Phase.FAULT
    assert "fins did not reach" in final.message
