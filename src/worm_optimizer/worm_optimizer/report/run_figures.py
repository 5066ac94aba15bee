# SPDX-License-Identifier: Apache-2.0
"""Figures of recorded gaits: motion, length and energy."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from worm_model.analysis import plot_style, run_plots
from worm_model.analysis.run_curves import (
    energy_curves,
    length_curves,
    position_curves,
    power_curves,
    value_at_onset,
)
from worm_model.run import seconds
from worm_model.simulation.simulator import Motions, simulate
from worm_optimizer.report.recorded_gait import RecordedGait

RIDGES = 5  # number of ridges that the paper's runs traverse
_BEFORE = 1.0  # time shown before the onset and after the end of a gait, s
_MODEL_SAMPLES = 2000  # number of samples of the predicted motion
_MODEL = "model, from the command alone"


def draw_motion(gait: RecordedGait) -> Figure:
    """Draw x1 according to the tracker and according to the twin, and the difference of the two.

    The input of the twin is the recorded length.
    """
    positions, residuals = position_curves(gait.run, gait.replay, gait.played.onset)
    return run_plots.motion_figure(
        _frame(gait), positions, residuals, gait.content.parameters.pitch
    )


def draw_length(gait: RecordedGait) -> Figure:
    """Draw measured ΔL, ΔL predicted from the command alone, and the inputs u_cmd and u_eff (eq:slack_clip)."""
    lengths, inputs = length_curves(gait.run, gait.played.onset, gait.content.parameters)
    return run_plots.length_figure(_frame(gait), lengths, inputs)


def draw_energy(gait: RecordedGait) -> Figure:
    """Draw measured and predicted source power and accumulated energy, until the robot has passed `RIDGES` ridges.

    If it never does, the figure ends shortly after the gait.
    """
    onset = gait.played.onset
    powers = power_curves(gait.run, gait.replay, onset)
    energies, residuals = energy_curves(gait.run, gait.replay, onset)
    time, model = _model_of(gait)
    powers = [*powers, run_plots.Curve(_MODEL, time, model.power, plot_style.EFFECTIVE)]
    energies = [*energies, run_plots.Curve(_MODEL, time, model.energy, plot_style.EFFECTIVE)]
    return run_plots.energy_figure(
        _frame(gait, ridges_passed_at(gait)), powers, energies, residuals
    )


RUN_FIGURES: Mapping[str, tuple[Callable[[RecordedGait], Figure], str]] = {
    "motion": (
        draw_motion,
        "Position of the rear module: measured, and predicted by the twin from the measured length. Below: the "
        "difference.",
    ),
    "length": (
        draw_length,
        "Length change: measured, and predicted from the command with slack, lag and gain. Below: the command and the "
        "effective command.",
    ),
    "energy": (
        draw_energy,
        "Source power, accumulated energy, and measured energy minus that of the twin, until five ridges are passed. "
        "The twin is driven by the measured length, the model by the command alone.",
    ),
}


def _model_of(gait: RecordedGait) -> tuple[NDArray[np.float64], Motions]:
    """Return times (s) and the motion that the model predicts at these times from the command alone."""
    trajectory = simulate(gait.expected.nominal.gait, gait.content.parameters, gait.played.cycles)
    time = np.linspace(0.0, trajectory.duration, _MODEL_SAMPLES)
    return time, trajectory.at(time)


def ridges_passed_at(gait: RecordedGait) -> float:
    """Return the time (s since the onset) at which the rear module has advanced by `RIDGES` pitches; NaN if never."""
    tracker = gait.run.tracker
    time = seconds(tracker.stamp, gait.played.onset)
    start = value_at_onset(time, tracker.rear_position)
    advance = gait.gait.direction * (tracker.rear_position - start)
    past = np.flatnonzero((time > 0.0) & (advance >= RIDGES * gait.content.parameters.pitch))
    return float(time[past[0]]) if past.size else float("nan")


def _duration(gait: RecordedGait) -> float:
    return gait.played.cycles * gait.gait.period


def _frame(gait: RecordedGait, until: float = float("nan")) -> run_plots.Frame:
    """Return the frame of a figure: its first and last time, and the window of the averaged cycles.

    The last time is ``until`` (s since the onset). If it is NaN, the frame ends `_BEFORE` after the gait.
    """
    window = np.array([gait.window.start, gait.window.end])
    start, end = seconds(window, gait.played.onset)
    last = until if np.isfinite(until) else _duration(gait) + _BEFORE
    return run_plots.Frame(-_BEFORE, last, (float(start), float(end)))
