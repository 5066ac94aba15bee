# SPDX-License-Identifier: Apache-2.0
"""Current and missing values, possible actions and their obstacles, and the history."""

import math
from dataclasses import replace

import pytest

from worm_model.run import Activity, LengthSource
from worm_model.twin.data.records import Health, ResidualRecord, StateRecord
from worm_optimizer.console import view
from worm_optimizer.snapshot import DriverState, Snapshot

NOW = 50.0
IDLE = DriverState(Activity.IDLE, True, False, 0, 0, 0, 0.0, 0.0, 1, "")
TWIN = StateRecord(0, LengthSource.MEASURED, *(0.3, 0.0, 0.3, 0.0, 0.0, 0.3, 0.0, 0.0, 0.0, 0.3),
                   *(0, 0), *(0.0, 0.0, 0.0, 2.0, 0.0))  # fmt: skip
RECEIVED = dict.fromkeys(view.SOURCES, NOW)


def snapshot(state: Activity = Activity.IDLE, **values) -> Snapshot:
    return Snapshot(driver=replace(IDLE, state=state, **values), twin=TWIN, received=RECEIVED)


def test_a_topic_is_live_for_a_second():
    received = Snapshot(received={"power": NOW - 0.9, "tracker": NOW - 1.1})
    assert view.is_live(received, "power", NOW)
    assert not view.is_live(received, "tracker", NOW)
    assert not view.is_live(received, "twin/state", NOW)


def test_missing_sources_are_named_with_their_silence():
    receptions = {**RECEIVED, "tracker": NOW - 7.0}
    del receptions["power"]
    assert view.missing_sources(snapshot(), NOW) == []
    silent = replace(snapshot(), received=receptions)
    assert view.missing_sources(silent, NOW) == ["power: no message yet", "tracker: silent for 7 s"]


def test_no_source_is_missing_unless_the_driver_is_active():
    inactive = replace(snapshot(Activity.INACTIVE), received={})
    assert view.missing_sources(inactive, NOW) == []
    assert view.missing_sources(Snapshot(), NOW) == []
    assert view.state_text(Snapshot()) == "no driver"


def test_old_values_are_not_shown():
    lengths = dict.fromkeys(LengthSource, 0.3)
    known = replace(snapshot(), lengths=lengths, power=2.5, twin_age=0.4)
    assert view.sample(known, NOW).power == 2.5
    assert view.sample(known, NOW).predicted == 2.0
    assert view.sample(known, NOW).commanded == 0.3
    assert view.sample(known, NOW).twin_age == 0.4
    assert all(
        math.isnan(value)
        for name, value in vars(view.sample(known, NOW + 2.0)).items()
        if name not in ("time", "twin_age")
    )


@pytest.mark.parametrize(
    ("given", "possible"),
    [
        (snapshot(Activity.INACTIVE), {"Home", "Activate"}),
        (snapshot(Activity.INACTIVE, emergency_stop=True), {"Home"}),
        (snapshot(Activity.IDLE), {"Deactivate", "Run"}),
        (snapshot(Activity.IDLE, emergency_stop=True), {"Deactivate"}),
        (snapshot(Activity.RUNNING), {"Deactivate"}),
        (snapshot(Activity.FAULT), {"Deactivate"}),
        (Snapshot(), set()),
    ],
)
def test_possible_actions_follow_from_the_state(given: Snapshot, possible: set[str]):
    reasons = view.obstacles(given, "", "")
    assert {name for name, reason in reasons.items() if not reason} == possible


def test_the_age_of_the_twins_data_is_shown():
    residuals = ResidualRecord(0, *(0.0,) * 7, Health.SUSPECT, "a fin slips")
    received = {**RECEIVED, "twin/residuals": NOW}
    known = replace(snapshot(), residuals=residuals, twin_age=0.43, received=received)
    assert view.twin_text(known, NOW) == "twin: suspect, a fin slips, 0.4 s behind"
    assert view.twin_text(replace(known, twin_age=math.nan), NOW) == "twin: suspect, a fin slips"
    assert view.twin_text(known, NOW + 2.0) == "twin: no message"


def test_a_common_obstacle_is_the_reason_for_each_action():
    assert set(view.obstacles(snapshot(), "no control", "").values()) == {"no control"}
    assert set(view.obstacles(Snapshot(), "", "").values()) == {"there is no driver"}


def test_deactivate_is_possible_while_a_recording_closes_but_not_during_a_run():
    reasons = view.obstacles(snapshot(holding=True), "", "wait")
    assert {name for name, reason in reasons.items() if not reason} == {"Deactivate"}
    assert all(view.obstacles(snapshot(Activity.RUNNING), "", "wait").values())


def test_margin_and_grooves_of_the_last_cycles_as_text():
    measured = replace(TWIN, margin_grooves=2, rear_margin=1.9e-3, rear_margin_scatter=8e-4)
    text = view.margin_text(replace(snapshot(), twin=measured), NOW, [1, *[2] * 8])
    assert "2 grooves, 1.9 ± 0.8 mm to spare" in text
    assert "2, 2, 2, 2, 2, 2, 2, 2" in text
    assert "1, 2" not in text
    assert view.margin_text(snapshot(), NOW + 2.0, [2]) == ""


def test_the_state_of_the_driver_as_text():
    assert view.state_text(snapshot(Activity.RUNNING, cycle=2, cycles=5)) == "running, cycle 2 of 5"
    assert view.state_text(snapshot(emergency_stop=True)) == "emergency stop, idle"
    left_on = "an earlier driver left the torque on"
    assert view.state_text(snapshot(Activity.INACTIVE)) == "inactive"
    assert view.state_text(snapshot(Activity.INACTIVE, message=left_on)) == f"inactive: {left_on}"
    assert view.state_text(snapshot(Activity.FAULT, message="servo 2 is silent")) == (
        "fault: servo 2 is silent"
    )


def test_a_stop_is_shown_before_its_confirmation_and_until_a_person_acts():
    running = snapshot(Activity.RUNNING, cycle=2, cycles=5)
    assert view.state_text(running, stopping=True).startswith("STOP is not confirmed yet, running")
    holding = snapshot(Activity.IDLE, holding=True)
    assert view.state_text(holding, stopping=True) == "stopped, holding"
    assert view.state_text(holding) == "stopped, holding"
    assert view.state_text(snapshot(Activity.IDLE)) == "idle"


def test_the_history_has_a_minute():
    history = view.History(lambda: NOW)
    for _ in range(1000):
        history.add(snapshot())
    assert len(history.samples) == 300


PERIOD_NS, LATE_NS = 5 * 10**9, 450_000_000


@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize("before", [0, 7])
def test_grooves_of_a_cycle_are_counted_at_its_stamps_although_the_twin_lags(
    direction: int, before: int
):
    """The twin still has the grooves of the run before when the driver says that the next one has begun."""
    history = view.History(lambda: NOW)
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
        history.add(Snapshot(driver=driver, twin=TWIN, received=RECEIVED, grooves=states))
    assert history.grooves == list(gained)


def test_a_stopped_cycle_has_no_grooves():
    history = view.History(lambda: NOW)
    onset = 10**12
    stop = onset + PERIOD_NS + PERIOD_NS // 2
    for now in range(onset, onset + 3 * PERIOD_NS, 200_000_000):
        state = Activity.RUNNING if now < stop else Activity.IDLE
        driver = replace(IDLE, state=state, run=1, frequency=0.2, stamp_ns=min(now, stop))
        driver = replace(driver, onset_ns=onset if now < stop else 0)
        states = tuple((now - LATE_NS - 10_000_000 * k, 1) for k in range(50, 0, -1))
        history.add(Snapshot(driver=driver, twin=TWIN, received=RECEIVED, grooves=states))
    assert history.grooves == [0]
