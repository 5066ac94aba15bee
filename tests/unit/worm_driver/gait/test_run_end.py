# SPDX-License-Identifier: Apache-2.0
"""Conditions at which a run ends."""

import math

import pytest

from worm_driver.driver_errors import RejectedError
from worm_driver.gait import gait_player
from worm_driver.gait.gait_limits import GaitLimits
from worm_driver.gait.gait_metrics import RunRecord
from worm_driver.gait.gait_player import Phase, PlayedRun, PlayerState
from worm_driver.gait.run_end import (
    PERIOD,
    HeartbeatMonitor,
    RunEnd,
    is_near_cycle_end,
    makes_no_progress,
    shorter_timeout,
    unseen_cycle,
)
from worm_msgs.gait import Gait

PITCH, ONSET = 0.0173, 10.0
GAIT = Gait(0.07, 0.2)
LIMITS = GaitLimits(0.09, 0.4, 0.12)
RUN = PlayedRun(1, GAIT, 1000, 1000, rest_start=8.0, onset=ONSET)


def seen(cycles: float, per_cycle: float = PITCH, direction: int = 1) -> RunRecord:
    """Return the tracker's samples at 30 Hz up to a cycle; the robot gains evenly, and its fins deflect by 4 mm."""
    record = RunRecord()
    for sample in range(-10, math.floor(cycles / GAIT.frequency * 30) + 1):
        gone = max(0.0, sample / 30 * GAIT.frequency)
        bent = 0.004 * min(1.0, 10.0 * gone)
        record.positions.append((ONSET + sample / 30, direction * (gone * per_cycle + bent)))
    return record


@pytest.mark.parametrize("end", [RunEnd(grooves=3), RunEnd(distance=3 * PITCH), RunEnd(9, 3)])
def test_it_is_reached_at_the_end_of_the_cycle_that_gains_the_last_groove(end):
    assert not end.is_reached(RUN, seen(1.97), PITCH)
    assert end.is_reached(RUN, seen(2.999), PITCH)
    assert not end.is_reached(RUN, seen(3.4), PITCH), "in the middle of a cycle nothing is judged"


@pytest.mark.parametrize(("share", "begins"), [(0.5, 0.9), (0.2, 0.84), (0.8, 0.96)])
def test_the_end_of_a_cycle_is_that_of_its_extension(share, begins):
    run = PlayedRun(1, Gait(0.07, 0.2, contraction_share=share), 9, 9, onset=ONSET)
    for phase in (0.1, share, begins - 0.01, begins + 0.01, 0.999):
        record = RunRecord(positions=[(ONSET + (1.0 + phase) / 0.2, 0.0)])
        assert is_near_cycle_end(run, record) == (phase > begins)


def test_deflection_of_the_fins_is_no_groove():
    """The displacement of the first cycle is 0.73 of a pitch where no groove was gained."""
    record = seen(0.99, per_cycle=0.73 * PITCH - 0.004)
    assert not RunEnd(grooves=1).is_reached(RUN, record, PITCH)


def test_a_reverse_gait_gains_backwards():
    run = PlayedRun(1, Gait(0.07, 0.2, -1), 9, 9, onset=ONSET)
    assert RunEnd(grooves=2).is_reached(run, seen(2.0 - 1e-3, direction=-1), PITCH)
    assert not RunEnd(grooves=2).is_reached(run, seen(2.0 - 1e-3), PITCH)


def test_cycles_bound_a_run_and_without_them_the_limits_do():
    assert RunEnd(cycles=7, grooves=3).most_cycles(GAIT, LIMITS) == 7
    assert RunEnd(grooves=3).most_cycles(GAIT, LIMITS) == 1000
    assert RunEnd(distance=1.0).most_cycles(Gait(0.07, 0.02), LIMITS) == 144
    with pytest.raises(RejectedError, match="needs an end"):
        RunEnd().most_cycles(GAIT, LIMITS)
    for distance in (math.nan, -1.0, math.inf):
        with pytest.raises(RejectedError, match="distance is"):
            RunEnd(distance=distance).most_cycles(GAIT, LIMITS)


def test_a_cycle_whose_end_the_tracker_missed_is_reported_once():
    assert unseen_cycle(RUN, judged=1, now=ONSET + 5.0 + 5.2) == 0
    assert unseen_cycle(RUN, judged=1, now=ONSET + 5.0 + 5.6) == 2
    assert unseen_cycle(RUN, judged=2, now=ONSET + 5.0 + 5.6) == 0
    assert not is_near_cycle_end(RUN, RunRecord())


def test_three_cycles_without_a_groove_make_no_progress():
    assert not makes_no_progress(RUN, seen(2.99, 0.0), PITCH)
    assert makes_no_progress(RUN, seen(3.99, 0.0), PITCH)
    assert not makes_no_progress(RUN, seen(3.99), PITCH)


def test_a_run_that_is_finished_ends_as_completed_with_its_cycle():
    state = PlayerState(phase=Phase.RUNNING, run=RUN)
    run = gait_player.finish(state, ONSET + 12.0).run
    assert (run.cycles, run.stop_cycle) == (3, 3)
    resting = PlayerState(phase=Phase.RESTING, run=PlayedRun(1, GAIT, 5, 5))
    assert gait_player.finish(resting, 0.0) == resting


def test_an_owner_is_silent_after_a_timeout_without_heartbeats_and_not_after_the_drivers_pause():
    owner = HeartbeatMonitor(1.0, 0.0)
    for look in range(100):
        if look % 3 == 0:
            owner.record()
        assert not owner.is_silent(look * PERIOD)
    owner = HeartbeatMonitor(1.0, 0.0)
    silent = [owner.is_silent(look * PERIOD) for look in range(1, 15)]
    assert silent == [look * PERIOD > 1.0 + 1e-9 for look in range(1, 15)]
    assert not HeartbeatMonitor(1.0, 0.0).is_silent(30.0)


def test_the_shorter_timeout_holds():
    assert {shorter_timeout(*each) for each in ((2.0, 0.0), (0.0, 2.0), (2.0, 3.0))} == {2.0}
    assert shorter_timeout(0.0, 0.0) == math.inf
