# SPDX-License-Identifier: Apache-2.0
"""Clocks that jump, twins that come late and times of which nothing is known, on robots that are not worm_model's."""

from functools import lru_cache

import numpy as np
import pytest
from faulty_robots import ONSET, Fault, run_robots

from worm_model.gait import Gait
from worm_model.parameters import PAPER
from worm_model.run import GaitStates, LengthSamples, PowerSamples, Run, TrackerSamples
from worm_model.twin.offline_replay import Replay, replay_run
from worm_model.twin.records import Event
from worm_model.twin.samples import Kind
from worm_model.twin.twin import Twin

GAIT = Gait(0.08, 0.2)
SECOND = 10**9


@lru_cache
def sound() -> np.ndarray:
    """What is seen of a sound robot, as it comes."""
    return run_robots(GAIT, [Fault()], seed=9).rows(0, tracker=True)


def jumped(rows: np.ndarray, time: float, by: float) -> np.ndarray:
    """The same, the clock having been set at a time (s)."""
    rows = rows.copy()
    after = rows["stamp"] > ONSET + round(time * SECOND)
    for name in ("stamp", "heard"):
        rows[name][after] += round(by * SECOND)
    rows["onset"][after & (rows["onset"] > 0)] += round(by * SECOND)
    return rows


def live(rows: np.ndarray, many: int = 40) -> list[Event]:
    twin = Twin()
    state = twin.start()
    events: list[Event] = []
    for k in range(0, len(rows), many):
        events += twin.advance(state, rows[k : k + many]).events
    return [*events, *twin.advance(state, rows[:0], to_the_end=True).events]


def recording(rows: np.ndarray) -> Run:
    """The rows as a recorded run."""

    def of(kind: Kind) -> np.ndarray:
        return rows[rows["kind"] == kind]

    gait, command, power = of(Kind.GAIT), of(Kind.COMMAND), of(Kind.POWER)
    length, tracker = of(Kind.LENGTH), of(Kind.POSITION)
    return Run(
        origin=int(rows["stamp"].min()),
        commanded=LengthSamples(
            command["stamp"], command["a"] + PAPER.initial_length, command["a"]
        ),
        measured=LengthSamples(length["stamp"], length["a"], length["a"] - PAPER.initial_length),
        tracker=TrackerSamples(tracker["stamp"], tracker["a"], tracker["b"]),
        power=PowerSamples(
            power["stamp"], 0 * power["stamp"], 0 * power["a"], 0 * power["a"], power["a"]
        ),
        gait_state=GaitStates(
            gait["stamp"],
            gait["state"],
            gait["a"],
            gait["b"],
            gait["c"].astype(np.int64),
            gait["d"],
            gait["onset"],
            gait["cycle"],
            0 * gait["cycle"],
            gait["run"],
        ),
    )


def replayed(rows: np.ndarray, received: np.ndarray) -> Replay:
    times = {kind: received[rows["kind"] == kind] for kind in Kind}
    return replay_run(recording(rows), PAPER, received=times)


def offline(rows: np.ndarray, received: np.ndarray) -> list[Event]:
    return list(replayed(rows, received).notices)


@pytest.mark.parametrize(("time", "by"), [(12.3, -3.0), (12.3, -100.0), (9.9, -3.0), (12.3, 500.0)])
def test_a_clock_that_was_set_gives_the_same_words_live_and_offline(time: float, by: float):
    rows = jumped(sound(), time, by)
    said = live(rows)
    assert repr(offline(rows, sound()["stamp"])) == repr(said)
    codes = [event.code for event in said if event.code]
    assert codes == ["clock_jump"]


@pytest.mark.parametrize("late", [7.3, 11.0, 14.9])
def test_a_twin_that_comes_late_claims_no_grooves(late: float):
    rows = sound()
    first = ONSET + round(late * SECOND)
    words = rows[(rows["kind"] == Kind.GAIT) & (rows["stamp"] < first)][-1:]
    events = live(np.concatenate([words, rows[rows["stamp"] >= first]]))
    assert [event.code for event in events if event.code] == []
    assert any("the tracker's word for where the robot stands" in e.text for e in events)


@pytest.mark.parametrize("lasts", [3.0, 7.0])
def test_a_gap_in_all_topics_is_a_gap_in_knowledge(lasts: float):
    rows = sound()
    time = (rows["stamp"] - ONSET) / SECOND
    events = live(rows[(time < 8.2) | (time > 8.2 + lasts)])
    codes = {event.code for event in events if event.code}
    assert codes == {"gap"}
    assert not any("the robot gained" in event.text for event in events)


@pytest.mark.parametrize("kind", [Kind.LENGTH, Kind.POSITION, Kind.POWER])
@pytest.mark.parametrize("lag", [0.1, 0.24, 0.4, 0.9])
def test_late_samples_are_treated_alike_live_and_offline(kind: Kind, lag: float):
    """Samples that come so late (s): within the delay it does not matter, beyond it they are left and counted."""
    rows = sound()
    late = (rows["kind"] == kind) & (np.random.default_rng(4).random(len(rows)) < 0.3)
    came = rows["stamp"] + round(lag * SECOND) * late
    order = np.argsort(came, kind="stable")
    twin = Twin()
    state = twin.start()
    outputs = [twin.advance(state, rows[order][k : k + 9]) for k in range(0, len(rows), 9)]
    outputs.append(twin.advance(state, rows[:0], to_the_end=True))
    found = replayed(rows[order], came[order])
    for name in ("states", "residuals"):
        said = np.concatenate([getattr(output, name) for output in outputs])
        for field, column in getattr(found, name).items():
            assert said[field].tobytes() == column.tobytes()
    assert repr(found.notices) == repr(tuple(e for o in outputs for e in o.events))
    left = {name: n for name, n in state.counts.items() if n and name != "taken"}
    assert found.dropped == left
    # The last ones of a recording are late for nothing.
    few = 0.95 * np.count_nonzero(late) if lag > 0.25 else 0.0
    assert few <= left.pop("late", 0) <= np.count_nonzero(late) * (lag > 0.25)
    assert not left
