# SPDX-License-Identifier: Apache-2.0
"""What is live, what is silent, what may be pressed and why not, and what is remembered."""

import math
from dataclasses import replace

import pytest

from worm_model.twin.records import Activity, Health, LengthSource, ResidualRecord, StateRecord
from worm_optimizer.console.view import (
    SOURCES,
    History,
    live,
    obstacles,
    sample,
    silences,
    state_words,
    twin_words,
)
from worm_optimizer.snapshot import DriverWord, Snapshot

NOW = 50.0
IDLE = DriverWord(Activity.IDLE, True, False, 0, 0, 0, 0.0, 0.0, 1, "")
TWIN = StateRecord(0, LengthSource.MEASURED, *(0.3, 0.0, 0.3, 0.0, 0.0, 0.3, 0.0, 0.0, 0.0, 0.3),
                   *(0, 0), *(0.0, 0.0, 0.0, 2.0, 0.0))  # fmt: skip
HEARD = dict.fromkeys(SOURCES, NOW)


def snapshot(state: Activity = Activity.IDLE, **values) -> Snapshot:
    return Snapshot(driver=replace(IDLE, state=state, **values), twin=TWIN, heard=HEARD)


def test_what_was_heard_within_a_second_is_live():
    heard = Snapshot(heard={"power": NOW - 0.9, "tracker": NOW - 1.1})
    assert live(heard, "power", NOW)
    assert not live(heard, "tracker", NOW)
    assert not live(heard, "twin/state", NOW)


def test_what_has_fallen_silent_is_told_apart_from_what_was_never_heard():
    heard = {**HEARD, "tracker": NOW - 7.0}
    del heard["power"]
    assert silences(Snapshot(heard=HEARD), NOW) == []
    assert silences(Snapshot(heard=heard), NOW) == [
        "power: not heard",
        "tracker: silent for 7 s",
    ]


def test_silent_numbers_are_not_shown_as_the_present():
    lengths = dict.fromkeys(LengthSource, 0.3)
    known = replace(snapshot(), lengths=lengths, power=2.5, twin_age=0.4)
    assert sample(known, NOW).power == 2.5
    assert sample(known, NOW).predicted == 2.0
    assert sample(known, NOW).commanded == 0.3
    assert sample(known, NOW).twin_age == 0.4
    assert all(
        math.isnan(value)
        for name, value in vars(sample(known, NOW + 2.0)).items()
        if name not in ("time", "twin_age")
    )


@pytest.mark.parametrize(
    ("given", "pressable"),
    [
        (snapshot(Activity.INACTIVE), {"Home", "Activate"}),
        (snapshot(Activity.INACTIVE, emergency_stop=True), {"Home"}),
        (snapshot(Activity.IDLE), {"Deactivate", "Run"}),
        (snapshot(Activity.IDLE, emergency_stop=True), {"Deactivate"}),
        (snapshot(Activity.RUNNING), {"Deactivate"}),
        (Snapshot(), set()),
    ],
)
def test_what_can_be_pressed_follows_from_the_state(given: Snapshot, pressable: set[str]):
    reasons = obstacles(given, "")
    assert {name for name, reason in reasons.items() if not reason} == pressable


def test_how_old_the_twins_words_are_is_told():
    residuals = ResidualRecord(0, *(0.0,) * 7, Health.SUSPECT, "a fin slips")
    heard = {**HEARD, "twin/residuals": NOW}
    known = replace(snapshot(), residuals=residuals, twin_age=0.43, heard=heard)
    assert twin_words(known, NOW) == "twin: suspect, a fin slips, 0.4 s behind"
    assert twin_words(replace(known, twin_age=math.nan), NOW) == "twin: suspect, a fin slips"
    assert twin_words(known, NOW + 2.0) == "twin: silent"


def test_what_hinders_all_is_the_reason_at_each():
    assert set(obstacles(snapshot(), "wait: homing").values()) == {"wait: homing"}
    assert set(obstacles(Snapshot(), "").values()) == {"no driver is heard"}


def test_the_state_is_told_in_words():
    assert state_words(Snapshot(), NOW) == "no driver heard"
    running = snapshot(Activity.RUNNING, cycle=2, cycles=5)
    assert state_words(running, NOW) == "running, cycle 2 of 5"
    assert state_words(running, NOW + 9.0) == "running, now silent, cycle 2 of 5"
    assert state_words(snapshot(emergency_stop=True), NOW) == "emergency stop, idle"


def test_a_minute_is_remembered():
    history = History(lambda: NOW)
    for _ in range(1000):
        history.add(snapshot())
    assert len(history.samples) == 300


@pytest.mark.parametrize("direction", [1, -1])
def test_the_grooves_of_each_cycle_are_counted_along_the_gait(direction: int):
    history = History(lambda: NOW)

    def moment(run: int, cycle: int, groove: int, state: Activity = Activity.RUNNING) -> None:
        driver = replace(IDLE, state=state, run=run, cycle=cycle, cycles=3, direction=direction)
        twin = replace(TWIN, rear_groove=direction * groove)
        history.add(Snapshot(driver=driver, twin=twin, heard=HEARD, lengths=lengths))

    lengths = {LengthSource.COMMANDED: 0.3}
    for cycle, groove in ((0, 0), (1, 0), (1, 1), (2, 2), (3, 3)):
        moment(1, cycle, groove)
    moment(1, 3, 5, Activity.IDLE)
    assert history.grooves == [2, 1, 2]
    moment(2, 1, 5)
    moment(2, 2, 6)
    assert history.grooves == [1]
    moment(2, 2, 6, Activity.IDLE)  # stopped before all cycles
    assert history.grooves == [1]
    moment(3, 3, 6)
    lengths[LengthSource.COMMANDED] = 0.25
    moment(3, 3, 8, Activity.IDLE)  # stopped within the last cycle
    assert history.grooves == []
