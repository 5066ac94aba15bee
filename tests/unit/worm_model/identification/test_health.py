# SPDX-License-Identifier: Apache-2.0
"""Drift over bags:

the rules of the charts on series with known answers, and the virtual robot with and without drift.
"""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from recorded_run import EPOCH, simulated_run, write_bag
from virtual_campaign import recording_of, run_of

from worm_driver.virtual_robot.offline_run import run_offline
from worm_driver.virtual_robot.virtual_settings import load_settings
from worm_model.commands import health as health_command
from worm_model.gait import Gait
from worm_model.identification import drift
from worm_model.identification.drift import State
from worm_model.identification.drift_estimates import estimate_bag, estimate_bags
from worm_model.identification.fits.estimate import Estimate
from worm_model.parameters import PAPER, ParameterFile
from worm_model.run import Run, TrackerSamples

GAIT = Gait(0.07, 0.4)
CYCLES = 4
HOUR = 3_600_000_000_000  # ns


def chart(key: str, values, half=1e-9, intervals=None) -> drift.Chart:
    estimates = [Estimate(v, v - half, v + half) for v in values]
    return drift.chart_of(key, estimates, ParameterFile(PAPER, intervals or {}))


def robot_run(seed: int, recording: int, gain: float = 1.0) -> Run:
    """Return a recording of the virtual robot, an hour after the one before; ``gain`` multiplies its K."""
    settings = replace(load_settings(), seed=seed, recording=recording)
    settings = replace(settings, body=replace(settings.body, gain=settings.body.gain * gain))
    seen = run_offline(settings, GAIT.length_change, CYCLES / GAIT.frequency)
    return run_of(seen, GAIT, settings, EPOCH + recording * HOUR)


def test_limits_are_those_of_a_chart_for_individuals():
    limits = drift.limits_of_bags(np.array([10.0, 12.0, 11.0, 14.0, 13.0]), resolution=0.0)
    assert limits.centre == pytest.approx(12.0)
    assert limits.high - 12.0 == pytest.approx(2.66 * (2 + 1 + 3 + 1) / 4)
    assert 12.0 - limits.low == pytest.approx(limits.high - 12.0)
    assert "Montgomery" in limits.source


GAIN = {"gain": (0.85, 0.87)}
RISING = [87.0, 90.0, 86.0, 87.0, 88.0, 89.0, 90.0, 91.0]
SLACKS = [0.0078, 0.0079, 0.0078, 0.0077, 0.0078, 0.0079, 0.0078, 0.0110, 0.0078, 0.0079]
SHRINKING = [0.865, 0.866, *(0.866 * 0.97**k for k in range(1, 7))]  # drags the mean along
SLOW = 90.0 + 0.1 * np.arange(6.0)


@pytest.mark.parametrize(
    ("key", "values", "half", "intervals", "state", "began", "direction", "advice"),
    [
        ("gain", [0.86, 0.85, 0.87, 0.5], 1e-9, None, State.TOO_FEW, None, 0, ""),
        ("gain", [0.868], 0.01, GAIN, State.WITHIN, None, 0, ""),
        ("gain", [0.83], 0.01, GAIN, State.OUT, 0, -1, "stretched"),
        ("gain", [np.nan] * 8, 0.01, GAIN, State.NOT_IDENTIFIABLE, None, 0, ""),
        ("gain", SHRINKING, 1e-9, None, State.TRENDING, 1, -1, "stretched"),
        ("idle_power", [1, 2, 3, np.nan, 4, 5, 6], 1e-9, None, State.TRENDING, 0, 1, "at rest"),
        ("slack", SLACKS, 1e-9, None, State.OUT, 7, 1, "re-tension"),
        ("viscous_friction", RISING, 1e-9, None, State.TRENDING, 2, 1, "clean the pipe"),
        ("viscous_friction", RISING[:-1], 1e-9, None, State.WITHIN, None, 0, ""),
        ("viscous_friction", SLOW, 3.0, None, State.WITHIN, None, 0, ""),
        ("viscous_friction", SLOW, 0.1, None, State.TRENDING, 0, 1, "clean the pipe"),
    ],
)
def test_a_chart_names_state_begin_and_direction(
    key, values, half, intervals, state, began, direction, advice
):
    """A trend takes six bags in one direction and more than the uncertainty of a bag; NaN is skipped."""
    found = chart(key, values, half, intervals)
    assert (found.state, found.began, found.direction) == (state, began, direction)
    assert advice in found.advice
    assert bool(found.advice) == bool(advice)


def test_the_limits_of_a_file_contain_its_uncertainty_and_that_of_a_bag():
    limits = chart("gain", [0.83], 0.01, GAIN).limits
    reach = limits.high - limits.centre
    assert reach == pytest.approx(3.0 * np.hypot(0.01, 0.01) / 1.959964, rel=1e-5)


@given(st.lists(st.floats(-1e3, 1e3), min_size=5, max_size=30), st.floats(0.0, 10.0))
def test_up_and_down_are_treated_alike(values, resolution):
    values = np.array(values)
    up, down = (
        drift.find_signals(v, drift.limits_of_bags(v, resolution)) for v in (values, -values)
    )
    assert {(s.rule, s.first, s.last, s.direction) for s in up} == {
        (s.rule, s.first, s.last, -s.direction) for s in down
    }


def test_steady_series_are_seldom_reported():
    draw = np.random.default_rng(0)
    series = draw.normal(size=(2000, 10))
    reported = [bool(drift.find_signals(v, drift.limits_of_bags(v, 1.96))) for v in series]
    assert np.mean(reported) < 0.03


# Estimates of seed 4 rise and fall by chance for six bags in a row, by less than the uncertainty of one bag.
@pytest.mark.night
def test_a_steady_robot_is_not_reported():
    bags = [
        estimate_bag(recording_of(robot_run(4, k), f"bag{k}"), PAPER).estimates for k in range(6)
    ]
    for key in drift.ADVICE:
        found = drift.chart_of(key, [bag[key] for bag in bags], ParameterFile())
        assert found.state is State.WITHIN


def test_a_falling_gain_is_found_and_what_is_no_bag_of_a_run_left_out(tmp_path: Path, run):
    factors = [1.0, 1.0, *(0.97**k for k in range(1, 6))]
    bags = [
        write_bag(tmp_path / f"bag{k}", robot_run(7, k, factor)) for k, factor in enumerate(factors)
    ]
    broken = tmp_path / "broken"
    broken.mkdir()
    (broken / "broken_0.mcap").write_bytes(b"no bag")
    status, out, err = run(health_command, *reversed(bags), broken, bags[0], "--json")
    assert status == 0
    found = json.loads(out)
    assert [bag["bag"] for bag in found["bags"]] == [bag.name for bag in bags]
    assert [bag["bag"] for bag in found["left_out"]] == ["broken"]
    gain = found["parameters"]["gain"]
    assert gain["verdict"] == State.TRENDING.value
    assert gain["direction"] == -1
    assert gain["began"] in {"bag0", "bag1"}, "the last steady bags, of which noise tells the first"
    assert "spool slips" in gain["advice"]
    others = {found["parameters"][key]["verdict"] for key in drift.ADVICE if key != "gain"}
    assert others == {State.WITHIN.value}
    assert found["healthy"] is False
    assert "health: 100%" in err


def test_a_drift_begins_after_the_last_bag_within_the_limits():
    """An outlier before them is no part of the drift."""
    rows = [(1, 1, 1), (9, 16, 1), (12, 12, 1), (2, 4, -1)]
    signals = [drift.Signal(drift.Rule.LIMIT, *row) for row in rows]
    chart = drift.Chart("gain", np.zeros(0), None, tuple(signals))
    assert chart.began == 9


def test_no_usable_bag_is_bad_input_of_one_line(tmp_path: Path, run):
    without = write_bag(tmp_path / "blind", replace(simulated_run(), tracker=TrackerSamples()))
    broken = tmp_path / "broken"
    broken.mkdir()
    status, out, err = run(health_command, without, broken)
    assert (status, out) == (2, "")
    line = err.strip().splitlines()[-1]
    assert line.startswith("health: no bag can be used: blind: only 0 samples of tracker")
    assert "(and 1 more)" in line


@pytest.mark.parametrize("seconds", [3.0, 1e3])
def test_a_bag_whose_markers_were_hidden_for_long_is_left_out(tmp_path: Path, seconds):
    run = simulated_run(cycles=2)
    since = (run.tracker.stamp - run.gait_state.onset.max()) * 1e-9
    hidden = np.where((since > 0.0) & (since < seconds), np.nan, run.tracker.front_position)
    tracker = replace(run.tracker, front_position=hidden)
    bag = write_bag(tmp_path / "hidden", replace(run, tracker=tracker))
    used, left_out = estimate_bags([bag], PAPER)
    assert used == []
    assert "a marker is hidden" in left_out[0].reason
