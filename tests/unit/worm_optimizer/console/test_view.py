# SPDX-License-Identifier: Apache-2.0
"""Current and missing values, possible actions and their obstacles."""

import math
from dataclasses import replace

import pytest

from worm_model.run import Activity, LengthSource
from worm_model.twin.data.records import Health, StateRecord
from worm_optimizer.console import view
from worm_optimizer.robot_commands import DriverState, Snapshot

NOW = 50.0
IDLE = DriverState(Activity.IDLE, True, False, 0, 0, 0, 0.0, 0.0, 1, "")
TWIN = StateRecord(0, LengthSource.MEASURED, *(0.3, 0.0, 0.3, 0.0, 0.0, 0.3, 0.0, 0.0, 0.0, 0.3),
                   *(0, 0), *(0.0, 0.0, 0.0, 2.0, 0.0))  # fmt: skip
RECEIVED = dict.fromkeys(view.SOURCES, NOW)


def snapshot(state: Activity = Activity.IDLE, **values) -> Snapshot:
    return Snapshot(driver=replace(IDLE, state=state, **values), twin=TWIN, received=RECEIVED)


def test_missing_sources_are_named_with_their_silence():
    receptions = {**RECEIVED, "tracker": NOW - 7.0}
    del receptions["power"]
    assert view.missing_sources(snapshot(), NOW) == []
    silent = replace(snapshot(), received=receptions)
    assert view.missing_sources(silent, NOW) == ["power: no message yet", "tracker: silent for 7 s"]


@pytest.mark.parametrize("given", [snapshot(Activity.INACTIVE), Snapshot()])
def test_no_source_is_missing_unless_the_driver_is_active(given: Snapshot):
    assert view.missing_sources(replace(given, received={}), NOW) == []


def test_old_values_are_not_shown():
    lengths = dict.fromkeys(LengthSource, 0.3)
    known = replace(snapshot(), lengths=lengths, power=2.5, twin_age=0.4)
    shown = view.sample(known, NOW)
    expected = {"power": 2.5, "predicted": 2.0, "commanded": 0.3, "twin_age": 0.4}
    assert {name: shown[name] for name in expected} == expected
    later = view.sample(known, NOW + 2.0)
    assert all(math.isnan(v) for name, v in later.items() if name not in ("time", "twin_age"))


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
    received = {**RECEIVED, "twin/residuals": NOW}
    told = {"health": Health.SUSPECT, "health_message": "a fin slips"}
    known = replace(snapshot(), **told, twin_age=0.43, received=received)
    assert view.twin_text(known, NOW) == "twin: suspect, a fin slips, 0.4 s behind"
    assert view.twin_text(replace(known, twin_age=math.nan), NOW) == "twin: suspect, a fin slips"
    assert view.twin_text(known, NOW + 2.0) == "twin: no message"
    no_run = replace(known, health=Health.UNKNOWN, health_message="")
    assert "nothing to compare with" in view.twin_text(no_run, NOW)


def test_a_common_obstacle_is_the_reason_for_each_action():
    assert set(view.obstacles(snapshot(), "no control", "").values()) == {"no control"}


def test_deactivate_is_possible_while_a_recording_closes_but_not_during_a_run():
    reasons = view.obstacles(snapshot(holding=True), "", "wait")
    assert {name for name, reason in reasons.items() if not reason} == {"Deactivate"}
    assert all(view.obstacles(snapshot(Activity.RUNNING), "", "wait").values())


def test_the_measured_margin_as_text():
    measured = replace(TWIN, margin_grooves=2, rear_margin=1.9e-3, rear_margin_scatter=8e-4)
    assert "2 grooves, 1.9 ± 0.8 mm to spare" in view.margin_text(measured)
    assert "probability" not in view.margin_text(measured)  # of one fin only
    both = view.margin_text(replace(measured, keeps_probability=0.9634))
    assert "measured probability 0.963" in both
    assert "above 0.998" in view.margin_text(replace(measured, keeps_probability=1.0))
    assert "spare" not in view.margin_text(TWIN)
    assert view.margin_text(None) == ""


LEFT_ON = "an earlier driver left the torque on"


@pytest.mark.parametrize(
    ("given", "stopping", "text"),
    [
        (Snapshot(), False, "no driver"),
        (snapshot(Activity.IDLE), False, "idle"),
        (snapshot(emergency_stop=True), False, "emergency stop, idle"),
        (snapshot(Activity.INACTIVE), False, "inactive"),
        (snapshot(Activity.INACTIVE, message=LEFT_ON), False, f"inactive: {LEFT_ON}"),
        (snapshot(Activity.FAULT, message="servo 2"), False, "fault: servo 2"),
        (snapshot(Activity.RUNNING, cycle=2, cycles=5), False, "running, cycle 2 of 5"),
        (snapshot(Activity.RUNNING), True, "STOP is not confirmed yet, running"),
        (snapshot(holding=True), True, "stopped, holding"),
        (snapshot(holding=True), False, "stopped, holding"),  # until a person acts
    ],
)
def test_the_state_of_the_driver_as_text(given: Snapshot, stopping: bool, text: str):
    assert view.state_text(given, stopping=stopping) == text
