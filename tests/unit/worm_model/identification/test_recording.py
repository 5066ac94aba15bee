# SPDX-License-Identifier: Apache-2.0
"""From a run to a recording, idle power, and the warnings about a run."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from recorded_run import Instruments, exact_run, joined, later
from scipy.stats import t as student
from twin_samples import run_of_rows
from virtual_campaign import recording_of
from virtual_session import Session

from worm_model.errors import IdentificationError
from worm_model.gait import Gait
from worm_model.identification.actuation_stage import identify_actuation
from worm_model.identification.data.observed_run import recordings_of
from worm_model.identification.fits.locomotion import traverse_of
from worm_model.identification.fits.measured_length import measured_length
from worm_model.identification.fits.quality import longest_gap, remarks, starts_apart, usable
from worm_model.identification.idle import idle_power, idle_power_of
from worm_model.parameters import PAPER
from worm_model.run import GaitStates, LengthSamples, Run, TrackerSamples

GAIT = Gait(0.08, 0.25)


@lru_cache
def exact(**instruments):
    return exact_run(GAIT, instruments=Instruments(**instruments), duration=7.0)


def run(**changes):
    return replace(exact(), **changes)


@lru_cache
def recording(**instruments):
    return recording_of(exact(**instruments), "r")


@lru_cache
def length_of(**instruments):
    return measured_length(recording(**instruments))


@pytest.mark.parametrize(
    ("field", "nothing", "topic"),
    [
        ("tracker", TrackerSamples(), "tracker"),
        ("commanded", LengthSamples(), "body_length/commanded"),
        ("gait_state", GaitStates(), "gait_state"),
    ],
)
def test_a_run_without_a_needed_topic_is_rejected_by_its_name(field, nothing, topic):
    with pytest.raises(IdentificationError, match=f"r: .*{topic}"):
        recording_of(run(**{field: nothing}), "r")


def twice(later_s: float, moved: float) -> Run:
    """Return a run followed by itself, later by a time in s and further by a distance in m."""
    return joined([exact(), later(exact(), round(later_s * 1e9), moved)])


def test_a_later_gait_counts_if_it_begins_at_the_start_of_the_first_one():
    (found,) = recordings_of(twice(12.0, 0.05), "r")
    assert found.end <= 10.0
    (remark,) = found.remarks
    assert remark.startswith("gait 2 (80 mm, 0.25 Hz)")
    assert "+50 mm" in remark
    first, second = recordings_of(twice(12.0, 0.002), "r")
    assert (first.name, second.name, first.remarks) == ("r", "r_gait_2", ())
    assert second.x1[:100] == pytest.approx(first.x1[:100], nan_ok=True)
    assert not starts_apart([first, second])
    (message,) = starts_apart([first, replace(second, start=0.1)])
    assert all(fact in message for fact in ("r and r_gait_2", "100 mm"))


def test_commands_that_are_not_the_gait_are_rejected():
    states = run().gait_state
    wrong = replace(states, stroke=np.full(2, 0.06))
    with pytest.raises(IdentificationError, match=r"are not the gait of 0\.06 m"):
        recording_of(run(gait_state=wrong), "r")


def test_a_run_that_does_not_rest_is_rejected():
    with pytest.raises(IdentificationError, match=r"only \d+ camera samples"):
        recording(rest=0.2)


def test_times_count_from_the_onset_and_x1_from_rest():
    tracker = exact().tracker
    moved = TrackerSamples(tracker.stamp, tracker.rear_position + 0.3, tracker.front_position + 0.3)
    found = recording_of(run(tracker=moved), "r")
    assert found.x1 == pytest.approx(recording().x1)
    assert found.command_time[0] == found.command[0] == 0.0
    assert found.camera_time[0] == pytest.approx(-1.997, abs=1e-3)
    assert abs(np.mean(found.x1[found.at_rest])) < 1e-4


def test_idle_power_is_that_of_the_samples_at_rest_with_students_interval():
    for rate, at_rest in ((3.0, 6), (1.5, 3)):  # a slow sensor also measures motion
        idle = idle_power_of(recording(power_rate=rate, power_noise=0.02))
        assert idle.samples == at_rest
        assert f"not at rest in {10 - at_rest} of the first ten" in idle.warning
        assert idle.value == pytest.approx(PAPER.idle_power, abs=0.05)
        half = student.ppf(0.975, idle.samples - 1) * idle.deviation
        found = idle_power([idle])
        assert (found.low, found.high) == pytest.approx((idle.value - half, idle.value + half))


def test_a_sensor_that_starts_with_the_gait_or_settles_is_reported():
    late = recording(power_noise=0.001)
    after = late.power_time > 0
    idle = idle_power_of(replace(late, power=late.power[after], power_time=late.power_time[after]))
    assert np.isnan(idle.value)
    assert "start the sensor before the gait" in idle.warning
    assert idle_power([idle]) is None
    known = idle_power_of(late)
    assert idle_power([idle, known]).value == known.value
    power = late.power + 0.5 * np.exp(-(late.power_time + 2.0) / 0.2)
    assert "still settling" in idle_power_of(replace(late, power=power)).warning


def test_the_measured_length_is_smooth_and_keeps_its_corners():
    length = length_of(camera_noise=0.0003)
    noiseless = length_of(camera_noise=0.0)
    at = np.linspace(0.1, 6.5, 200)
    difference = np.interp(at, length.time, length.length_change)
    difference -= np.interp(at, noiseless.time, noiseless.length_change)
    assert np.sqrt(np.mean(difference**2)) < 1.2e-4
    rate = np.interp(at, length.time, length.rate) - np.interp(at, noiseless.time, noiseless.rate)
    assert np.sqrt(np.mean(rate**2)) < 8e-4
    steepest = np.abs(np.diff(length.rate) / np.diff(length.time)).max()
    assert steepest > 0.25  # m/s²: the edges of the slack are not rounded off


def test_outliers_of_the_camera_are_left_out():
    found = recording()
    x2 = found.x2.copy()
    x2[[90, 150, 200]] += [0.05, -0.03, 0.01]
    length = measured_length(replace(found, x2=x2))
    assert set(np.flatnonzero(length.outliers)) == {90, 150, 200}


def test_hidden_markers_are_named_and_bridged():
    plain = recording()
    hidden = (plain.camera_time > 2.0) & (plain.camera_time < 3.5)
    found = replace(plain, x1=np.where(hidden, np.nan, plain.x1))
    length = measured_length(found)
    assert longest_gap(found) == pytest.approx(1.5, abs=0.1)
    texts = remarks(found, length, traverse_of(found, length, PAPER.pitch))
    assert "hidden marker, longest gap 1.5" in texts[0]
    assert "1.5 s" in texts[1]
    expected, at = length_of(), np.linspace(2.0, 3.5, 50)
    bridge = np.interp(at, length.time, length.length_change)
    assert bridge == pytest.approx(np.interp(at, expected.time, expected.length_change), abs=4e-4)


def test_a_run_of_too_few_ridges_is_named():
    found = recording_of(exact_run(GAIT, duration=4.5), "r")
    length = measured_length(found)
    traverse = traverse_of(found, length, PAPER.pitch)
    assert not traverse.complete
    assert "5 ridges" in " ".join(remarks(found, length, traverse))


@pytest.mark.parametrize("time", [0.3, 2.0, 4.0])
def test_a_stuck_servo_is_left_out_or_rejected_and_never_averaged(time):
    healthy = recording()
    stopped = healthy.camera_time > time
    held = healthy.x1 + healthy.length[np.flatnonzero(stopped)[0]]
    spoilt = replace(healthy, x2=np.where(stopped, held, healthy.x2))
    lengths = [length_of(), measured_length(spoilt)]
    kept, reasons = usable([healthy, spoilt], lengths)
    assert kept == [0]
    assert "stuck servo" in reasons[0]
    with pytest.raises(IdentificationError, match="stuck servo"):
        usable([spoilt], lengths[1:])


def test_a_gait_with_pretension_begins_once_the_driver_has_tensioned_the_cable():
    session = Session()
    gait = Gait(0.065, 0.2, pretension=0.015)
    session.run(gait, 3)
    truth = session.rig.virtual.plant.parameters
    recording = recordings_of(run_of_rows(session.rows), "tight")[0]
    assert recording.command[0] == -gait.pretension
    assert np.ptp(recording.length[recording.at_rest]) < 2e-3  # noise
    assert abs(recording.start) < 1e-3
    found = identify_actuation([recording], np.random.default_rng(0))
    assert found.gain.low - 0.005 <= truth.gain <= found.gain.high + 0.005
    assert measured_length(recording).initial_length == pytest.approx(
        truth.initial_length, abs=2e-4
    )
