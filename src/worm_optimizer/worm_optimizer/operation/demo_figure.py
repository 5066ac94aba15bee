# SPDX-License-Identifier: Apache-2.0
"""The one figure of a demo: where the robot went, how long it was, what it took; and the twin's view."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from worm_model.analysis.plot_style import save_figure
from worm_model.analysis.run_curves import length_curves, position_curves, power_curves
from worm_model.analysis.run_metrics import Window, last_played_gait
from worm_model.analysis.run_plots import Frame, overview_figure
from worm_model.parameters import Parameters
from worm_model.run import Run, seconds
from worm_model.twin.offline_replay import Replay

_AROUND_S = 2.0  # of rest before and after the gait that are shown


def draw_run(
    path: Path, title: str, run: Run, replay: Replay, window: Window, parameters: Parameters
) -> None:
    """Writes the figure of a run's last gait; the averaged cycles are shaded."""
    onset = last_played_gait(run.gait_state).onset
    start, end = seconds(np.array([window.start, window.end]), onset)
    frame = Frame(-_AROUND_S, float(end) + _AROUND_S, (float(start), float(end)), title)
    positions, residuals = position_curves(run, replay, onset)
    lengths, _ = length_curves(run, onset, parameters)
    powers = power_curves(run, replay, onset)
    save_figure(
        overview_figure(frame, positions, residuals, lengths, powers, parameters.pitch), path
    )
