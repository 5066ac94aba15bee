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


PERIOD_NS, LATE_NS = 5 * 10**9, 450_000_000


@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize("before", [0, 7])
def test_the_grooves_of_each_cycle_are_those_between_its_stamps_by_a_twin_that_is_behind(
    direction: int, before: int
):
    """The twin still has the grooves of the run before when the driver says that the next one has begun."""
    history = History(lambda: NOW)
    onset, gained = 10**12, (2, 1, 2)

    def rear_groove(stamp: int) -> int:
        if stamp < onset:
            return before
        cycle = min((stamp - onset) // PERIOD_NS, 2)
        part = ((stamp - onset) / PERIOD_NS - cycle) > 0.4
        return direction * (sum(gained[:cycle]) + gained[cycle] * part)

    for now in range(onset - 10**9, onset + 4 * PERIOD_NS, 200_000_000):
        cycle = min((now - onset) // PERIOD_NS + 1, 3)
        over = now >= onset + 3 * PERIOD_NS
        state = Activity.IDLE if over else (Activity.RUNNING if now >= onset else Activity.RESTING)
        begun = now - now % 10**9 if not over else onset + 3 * PERIOD_NS + 3_000_000
        driver = replace(IDLE, state=state, run=2, cycle=cycle, direction=direction, frequency=0.2)
        driver = replace(driver, stamp_ns=begun, onset_ns=onset if onset <= now and not over else 0)
        stamps = range(now - LATE_NS - 2 * 10**9, now - LATE_NS, 10_000_000)
        states = tuple((stamp, rear_groove(stamp)) for stamp in stamps)
        history.add(Snapshot(driver=driver, twin=TWIN, heard=HEARD, grooves=states))
    assert history.grooves == list(gained)


def test_a_cycle_that_was_stopped_has_no_grooves():
    history = History(lambda: NOW)
    onset = 10**12
    stop = onset + PERIOD_NS + PERIOD_NS // 2
    for now in range(onset, onset + 3 * PERIOD_NS, 200_000_000):
        state = Activity.RUNNING if now < stop else Activity.IDLE
        driver = replace(IDLE, state=state, run=1, frequency=0.2, stamp_ns=min(now, stop))
        driver = replace(driver, onset_ns=onset if now < stop else 0)
        states = tuple((now - LATE_NS - 10_000_000 * k, 1) for k in range(50, 0, -1))
        history.add(Snapshot(driver=driver, twin=TWIN, heard=HEARD, grooves=states))
    assert history.grooves == [0]
