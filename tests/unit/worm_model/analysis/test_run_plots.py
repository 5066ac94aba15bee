# SPDX-License-Identifier: Apache-2.0
"""The figures of a run: their content, and that their files do not depend on the time of their creation."""

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
from recorded_run import GAIT, simulated_run

from worm_model.analysis.plot_style import MEASURED, save_figure
from worm_model.analysis.run_curves import (
    energy_curves,
    length_curves,
    plot_run,
    position_curves,
    settled_power,
)
from worm_model.analysis.run_metrics import RecordingError, last_played_gait
from worm_model.analysis.run_plots import Curve, Frame, energy_figure
from worm_model.parameters import PAPER
from worm_model.run import PowerSamples, Run
from worm_model.twin.offline_replay import replay_run


@pytest.fixture(scope="module")
def followed():
    run = simulated_run(3)
    return run, replay_run(run, PAPER)


def test_settled_power_pairs_each_sample_with_its_own_residual(followed):
    run, replay = followed
    stamp, settled = settled_power(run, replay)
    measured = dict(zip(run.power.stamp.tolist(), run.power.power.tolist(), strict=True))
    residuals = zip(replay.residuals["stamp_ns"], replay.residuals["power"], strict=True)
    expected = {int(s): measured[int(s)] - r for s, r in residuals if math.isfinite(r)}
    assert dict(zip(stamp.tolist(), settled.tolist(), strict=True)) == expected
    assert settled_power(dataclasses.replace(run, power=PowerSamples()), replay)[0].size == 0


def test_positions_and_energies_count_from_the_rest_before_the_onset(followed):
    run, replay = followed
    onset = last_played_gait(run.gait_state).onset
    positions, residuals = position_curves(run, replay, onset)
    energies, _ = energy_curves(run, replay, onset)
    for curve in (*positions, *energies):
        assert abs(np.interp(0.0, curve.time, curve.values)) < 0.02
    assert residuals[0].time.min() >= 0.0
    assert np.nanstd(residuals[0].values) < 1e-3


def test_lengths_of_instruments_that_saw_nothing_are_left_out(followed):
    run, _ = followed
    lengths, inputs = length_curves(run, last_played_gait(run.gait_state).onset, PAPER)
    assert [curve.label for curve in lengths] == ["body, measured", "body, predicted"]
    assert min(inputs[0].values) == pytest.approx(-GAIT.stroke, rel=1e-2)


def test_files_are_the_same_each_time(tmp_path: Path):
    curve = Curve("measured", np.arange(3.0), np.arange(3.0), MEASURED)
    for ending in (".png", ".pdf", ".svg"):
        contents = []
        for k in range(2):
            path = tmp_path / f"{k}{ending}"
            save_figure(energy_figure(Frame(0.0, 2.0), [curve], [curve], [curve]), path)
            contents.append(path.read_bytes())
        assert contents[0] == contents[1]


def test_an_overview_needs_a_gait_and_has_position_residual_length_and_power(followed):
    run, replay = followed
    labels = [axes.get_ylabel() for axes in plot_run(run, replay, PAPER, "a run").axes]
    assert labels == [
        "rear module x1 (mm)",
        "residual (mm)",
        "length change ΔL (mm)",
        "source power (W)",
    ]
    with pytest.raises(RecordingError, match="gait_state"):
        plot_run(Run(), replay, PAPER)
