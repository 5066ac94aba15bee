# SPDX-License-Identifier: Apache-2.0
"""Clocks that jump, twins that are late and unknown times, on robots that are simulated independently of worm_model."""

from functools import lru_cache

import numpy as np
import pytest
from faulty_robots import ONSET, Fault, run_robots
from twin_samples import run_of_rows
from virtual_session import live_twin

from worm_model.analysis.replay_metrics import report_replay
from worm_model.gait import Gait
from worm_model.parameters import PAPER
from worm_model.twin.data.records import Event, Health
from worm_model.twin.data.samples import SampleKind
from worm_model.twin.offline_replay import Replay, replay_run
from worm_model.twin.twin import Twin

GAIT = Gait(0.08, 0.2)
SECOND = 10**9


@lru_cache
def healthy() -> np.ndarray:
    """Return the samples of a healthy robot in order of reception."""
    return run_robots(GAIT, [Fault()], seed=9).rows(0, tracker=True)


def jumped(rows: np.ndarray, time: float, by: float) -> np.ndarray:
    """Return the same with a clock that is set at a time (s)."""
    rows = rows.copy()
    after = rows["stamp"] > ONSET + time * SECOND
    for name in ("stamp", "sent"):
        rows[name][after] += round(by * SECOND)
    rows["onset"][after & (rows["onset"] > 0)] += round(by * SECOND)
    return rows


def live(rows: np.ndarray) -> tuple[Event, ...]:
    return live_twin(rows, many=40).events


def replayed(rows: np.ndarray) -> Replay:
    return replay_run(run_of_rows(rows), PAPER)


@pytest.mark.parametrize(("time", "by"), [(12.3, -3.0), (12.3, -100.0), (9.9, -3.0), (12.3, 500.0)])
def test_a_gait_in_which_the_clock_was_set_is_rejected_with_that_reason(time: float, by: float):
    rows = jumped(healthy(), time, by)
    assert {event.code for event in live(rows) if event.code} == {"clock_jump"}
    run = run_of_rows(rows)
    found = replay_run(run, PAPER)
    assert {event.code for event in found.notices if event.code} == {"clock_jump"}
    reports = report_replay(run, found, PAPER.pitch).runs
    assert reports
    assert all("the clock was set" in report.not_judged for report in reports)
    assert {report.health for report in reports} == {Health.UNKNOWN}


@pytest.mark.parametrize("ahead", [0.0, 1000.0])
def test_a_clock_that_jumps_after_a_run_restarts_the_twin(ahead: float):
    once = live_twin(healthy(), many=40)
    again = live_twin(np.concatenate([healthy(), jumped(healthy(), -np.inf, ahead)]), many=40)
    assert [event.code for event in again.events if event.code] == ["clock_jump"]
    assert sum("a run begins" in event.text for event in again.events) == 2
    for name, tolerance in (("energy", {"rel": 1e-9}), ("rear_position", {"abs": 1e-9})):
        assert again.states[name][-1] == pytest.approx(once.states[name][-1], **tolerance)


@pytest.mark.parametrize("by", [-3.0, -1.2])
def test_two_times_that_were_merged_into_one_are_no_grooves(by: float):
    """Stamps and log times were set back together: a bag's messages are read as if both times had been one."""
    rows = jumped(healthy(), 12.3, by)
    rows = rows[np.argsort(rows["stamp"], kind="stable")]
    found = replayed(rows)
    assert {event.code for event in found.notices if event.code} == {"clock_jump"}
    assert all("the clock was set" in cycle.not_judged for cycle in found.cycles)


@pytest.mark.parametrize("late", [7.3, 11.0, 14.9])
def test_a_twin_that_comes_late_claims_no_grooves(late: float):
    rows = healthy()
    first = ONSET + round(late * SECOND)
    latched = rows[(rows["kind"] == SampleKind.GAIT) & (rows["stamp"] < first)][-1:]
    events = live(np.concatenate([latched, rows[rows["stamp"] >= first]]))
    assert [event.code for event in events if event.code] == []
    assert any("the twin resets its position to the tracker's" in e.text for e in events)


@pytest.mark.parametrize("lasts", [3.0, 7.0])
def test_a_gap_in_all_topics_is_a_gap_in_knowledge(lasts: float):
    rows = healthy()
    time = (rows["stamp"] - ONSET) / SECOND
    events = live(rows[(time < 8.2) | (time > 8.2 + lasts)])
    codes = {event.code for event in events if event.code}
    assert codes == {"gap"}
    assert not any("the robot gained" in event.text for event in events)


@pytest.mark.parametrize(
    ("kind", "lag"),
    [(SampleKind.LENGTH, 0.9), (SampleKind.POSITION, 0.24), (SampleKind.POWER, 0.9)],
)
def test_offline_no_sample_is_late(kind: SampleKind, lag: float):
    """Samples are late by a time (s): live, those beyond the delay are excluded; a recording is sorted by stamp."""
    rows = healthy()
    late = (rows["kind"] == kind) & (np.random.default_rng(4).random(len(rows)) < 0.3)
    order = np.argsort(rows["stamp"] + round(lag * SECOND) * late, kind="stable")
    twin = Twin()
    state = twin.start()
    for k in range(0, len(rows), 9):
        twin.advance(state, rows[order][k : k + 9])
    left = {name: n for name, n in state.counts.items() if n and name != "taken"}
    few = 0.95 * np.count_nonzero(late) if lag > 0.25 else 0.0
    assert few <= left.get("late", 0) <= np.count_nonzero(late) * (lag > 0.25)
    found, whole = replayed(rows[order]), replayed(rows)
    assert not found.dropped
    for name in ("states", "residuals"):
        for field, column in getattr(found, name).items():
            assert column.tobytes() == getattr(whole, name)[field].tobytes()
    assert repr(found.notices) == repr(whole.notices)
