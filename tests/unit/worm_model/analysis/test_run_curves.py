# SPDX-License-Identifier: Apache-2.0
"""Curves of a run in one figure, as the demo and notebooks draw it."""

import pytest
from recorded_run import simulated_run

from worm_model.analysis.run_curves import plot_run
from worm_model.analysis.run_metrics import RecordingError
from worm_model.parameters import PAPER
from worm_model.run import Run
from worm_model.twin.offline_replay import replay_run


def test_an_overview_has_position_residual_length_and_power():
    run = simulated_run(3)
    figure = plot_run(run, replay_run(run, PAPER), PAPER, "a run")
    labels = [axes.get_ylabel() for axes in figure.axes]
    assert labels == [
        "rear module x1 (mm)",
        "residual (mm)",
        "length change ΔL (mm)",
        "source power (W)",
    ]
    assert figure.get_suptitle() == "a run"


def test_without_a_gait_there_is_no_overview():
    run = simulated_run(3)
    with pytest.raises(RecordingError, match="gait_state"):
        plot_run(Run(), replay_run(run, PAPER), PAPER)
