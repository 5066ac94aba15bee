# SPDX-License-Identifier: Apache-2.0
"""Figures of a recorded gait: windows, displacement over whole cycles, energy, and their table."""

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from recorded_run import GAIT, REST_S, simulated_run

from worm_model.parameters import PAPER
from worm_model.run import GaitStates, PowerSamples
from worm_model.simulation.simulator import simulate
from worm_model.twin.offline_replay import replay_run
from worm_optimizer.operation.demo_figure import draw_run
from worm_optimizer.operation.demo_table import comparison_table, relative_difference
from worm_optimizer.operation.gait_figures import (
    Figures,
    RecordingError,
    Window,
    accumulate,
    averaged_onset,
    averaged_window,
    figures,
    settled_power,
)

EPOCH = 1_700_000_000_000_000_000  # ns
MASS = 0.858


def gait_states(state, onset, cycles, frequency=0.2):
    count = len(state)
    return GaitStates(
        stamp=np.arange(count, dtype=np.int64),
        state=np.array(state),
        frequency=np.full(count, frequency),
        onset=np.array(onset, np.int64),
        cycles=np.full(count, cycles),
    )


def stamps(seconds):
    return EPOCH + np.round(np.asarray(seconds) * 1e9).astype(np.int64)


def test_the_last_three_of_five_cycles_are_averaged():
    window = averaged_window(gait_states([1, 2, 3, 3, 1], [0, 0, EPOCH, EPOCH, 0], 5))
    assert window == Window(EPOCH + 10_000_000_000, EPOCH + 25_000_000_000)
    assert window.duration == 15.0


def test_a_short_run_is_averaged_as_a_whole():
    window = averaged_window(gait_states([3], [EPOCH], 2))
    assert window == Window(EPOCH, EPOCH + 10_000_000_000)


def test_a_recording_without_a_gait_is_refused():
    with pytest.raises(RecordingError, match="no gait that was run"):
        averaged_window(gait_states([1, 2], [0, 0], 5))


@given(
    speed=st.floats(-0.05, 0.05).filter(lambda v: abs(v) > 1e-4),
    power=st.floats(0.1, 40.0),
    phase=st.floats(0.0, 0.03),
)
def test_steady_motion_gives_its_speed_and_power_at_any_phase_of_the_samples(speed, power, phase):
    time = np.arange(0.0, 30.0, 1.0 / 30.0) + phase
    window = Window(EPOCH + 5_000_000_000, EPOCH + 20_000_000_000)
    position = (stamps(time), 0.3 + speed * time)
    energy = accumulate(stamps(time), np.full(time.size, power))
    result = figures(position, energy, MASS, window)
    assert result.speed == pytest.approx(speed, rel=1e-6)
    assert result.power == pytest.approx(power, rel=1e-6)
    assert result.cost_of_transport == pytest.approx(power / (MASS * 9.80665 * abs(speed)))


def test_samples_that_are_missing_do_not_count():
    time = np.arange(0.0, 30.0, 0.1)
    power = np.full(time.size, 2.0)
    position = 0.01 * time
    power[50:60] = math.nan
    position[97:103] = math.nan
    window = Window(EPOCH + 10_000_000_000, EPOCH + 20_000_000_000)
    result = figures((stamps(time), position), accumulate(stamps(time), power), MASS, window)
    assert result.power == pytest.approx(2.0)
    assert result.speed == pytest.approx(0.01)


def test_energy_is_the_integral_of_power():
    time = np.linspace(0.0, 2.0, 201)
    _, energy = accumulate(stamps(time), 3.0 * time)
    assert energy[-1] == pytest.approx(6.0, rel=1e-6)
    assert accumulate(stamps([]), np.empty(0))[1].size == 0


def test_standing_still_has_no_finite_cost_of_transport():
    time = np.arange(0.0, 30.0, 0.1)
    window = Window(EPOCH, EPOCH + 20_000_000_000)
    energy = accumulate(stamps(time), np.ones(time.size))
    assert figures((stamps(time), 0.0 * time), energy, MASS, window).cost_of_transport == math.inf


@pytest.mark.parametrize("name", ["position", "energy"])
def test_a_recording_that_ends_too_early_is_refused(name):
    long, short = np.arange(0.0, 30.0, 0.1), np.arange(0.0, 12.0, 0.1)
    series = {"position": (stamps(long), long), "energy": (stamps(long), long)}
    series[name] = (stamps(short), short)
    with pytest.raises(RecordingError, match=f"no {name} over the averaged cycles"):
        figures(series["position"], series["energy"], MASS, Window(EPOCH, EPOCH + 20_000_000_000))


@pytest.fixture(scope="module")
def followed():
    run = simulated_run(3)
    return run, replay_run(run, PAPER)


def true_power(stamp):
    trajectory = simulate(GAIT, cycles=3)
    time = (stamp - simulated_run(3).origin) * 1e-9 - REST_S
    return trajectory.at(np.clip(time, 0.0, 3 * GAIT.period)).power, (time > 0.2) & (time < 7.0)


def test_the_power_in_the_states_is_as_good_as_that_beside_the_sensor(followed):
    """Both come once the lengths about them are known; what is left is the camera's noise of 0.1 mm."""
    run, replay = followed
    stamp, settled = settled_power(run, replay)
    true, moving = true_power(stamp)
    assert np.count_nonzero(moving) > 100
    assert np.std((settled - true)[moving]) < 0.4
    true, moving = true_power(replay.states["stamp_ns"])
    assert np.std((replay.states["power"] - true)[moving]) < 0.4


def test_settled_power_pairs_each_sample_with_its_own_residual(followed):
    run, replay = followed
    stamp, settled = settled_power(run, replay)
    measured = dict(zip(run.power.stamp.tolist(), run.power.power.tolist(), strict=True))
    residuals = zip(replay.residuals["stamp_ns"], replay.residuals["power"], strict=True)
    expected = {int(s): measured[int(s)] - r for s, r in residuals if math.isfinite(r)}
    assert dict(zip(stamp.tolist(), settled.tolist(), strict=True)) == expected
    assert settled_power(dataclasses.replace(run, power=PowerSamples()), replay)[0].size == 0


def test_the_figure_of_a_run_is_written(followed, tmp_path: Path):
    run, replay = followed
    draw_run(tmp_path / "run.png", "a run", run, replay, averaged_window(run.gait_state))
    assert (tmp_path / "run.png").read_bytes().startswith(b"\x89PNG")
    states = dataclasses.replace(run.gait_state, state=0 * run.gait_state.state)
    with pytest.raises(RecordingError, match="no gait"):
        averaged_onset(states)


def test_the_table_shows_differences_to_the_measurement():
    measured = Figures(0.005, 2.0, 50.0)
    table = comparison_table(measured, {"twin": Figures(0.0055, 1.9, 45.0)})
    lines = table.splitlines()
    assert "5.00 mm/s" in lines[1]
    assert "%" not in lines[1]
    for text in ("5.50 mm/s  +10.0 %", "1.90 W   -5.0 %", "45.0  -10.0 %"):
        assert text in lines[2]
    for head, value in (("speed", "5.50 mm/s"), ("power", "1.90 W"), ("transport", "45.0")):
        end = lines[0].index(head) + len(head)
        assert lines[2].index(value) + len(value) == end


def test_differences_of_nothing_are_not_numbers():
    assert math.isnan(relative_difference(1.0, 0.0))
    assert relative_difference(-0.9, -1.0) == pytest.approx(0.1)
