# SPDX-License-Identifier: Apache-2.0
"""Figures of the paper's Section V: bench fits, and x1, ΔL, power and energy of every run."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from matplotlib.figure import Figure

from worm_model.analysis.plot_style import (
    COMMANDED,
    COMMANDED_INPUT,
    EFFECTIVE,
    EFFECTIVE_INPUT,
    GREY,
    MEASURED,
    MM,
    PREDICTED,
    SAMPLES,
    finish,
    new_figure,
    symbol,
)
from worm_model.analysis.run_plots import (
    Curve,
    Frame,
    energy_figure,
    length_figure,
    motion_figure,
)
from worm_model.arrays import accumulated
from worm_model.identification.bellows import BellowsFit
from worm_model.identification.fin import FinFit
from worm_model.identification.run_prediction import RunPrediction, measured_power, predict
from worm_model.identification.run_selection import FittedRun
from worm_model.identification.stages import Identification
from worm_model.simulation.actuation import effective_command

_WIDTH = 6.4  # inches


def all_figures(result: Identification) -> Iterator[tuple[str, Figure]]:
    """Yield (name, figure) for each figure; only one figure at a time is in memory."""
    if result.bellows is not None:
        yield "bellows", bellows_figure(result.bellows)
    if result.fin is not None:
        yield "fin", fin_figure(result.fin)
    offset = float(result.actuation.fit.clock_offset.mean())
    for run in result.runs:
        prediction = predict(run, result.parameters, offset)
        yield f"{run.name}_motion", _motion(run, prediction, result.parameters.pitch)
        yield f"{run.name}_length", _length(run, prediction, result.parameters.slack)
        yield f"{run.name}_energy", energy_of_run(run, prediction)


def bellows_figure(fit: BellowsFit) -> Figure:
    """Plot the force as a function of the compression, with the fitted line."""
    figure = new_figure(_WIDTH, 3.2)
    axes = figure.subplots()
    axes.plot(fit.compression * MM, fit.force, **SAMPLES, label="measured")
    ends = np.array([0.0, fit.compression.max()])
    label = f"{symbol('k_b')} = {fit.stiffness.value:.1f} ± {fit.stiffness.spread:.1f} N/m"
    axes.plot(ends * MM, fit.offset + fit.stiffness.value * ends, **PREDICTED, label=label)
    axes.set_xlabel("compression (mm)")
    finish(axes, "force (N)")
    return figure


def fin_figure(fit: FinFit) -> Figure:
    """Plot the force as a function of the displacement, with the fitted piecewise linear force and its knees."""
    figure = new_figure(_WIDTH, 3.6)
    axes = figure.subplots()
    axes.plot(fit.displacement * MM, fit.force, **SAMPLES, label="measured")
    grid = np.linspace(fit.displacement.min(), fit.displacement.max(), 400)
    axes.plot(grid * MM, fit.force_at(grid), **PREDICTED, label="fitted")
    for sign in (-1.0, 1.0):
        knee = fit.centre + 0.5 * sign * fit.clearance.value
        axes.axvline(knee * MM, color=GREY, linewidth=0.8, linestyle=":")
    figure.suptitle(
        f"{symbol('k_eng')} = {fit.engaged_stiffness.value:.0f} ± {fit.engaged_stiffness.spread:.0f} N/m, "
        f"{symbol('k_dis')} = {fit.disengaged_stiffness.value:.0f} ± {fit.disengaged_stiffness.spread:.0f} N/m, "
        f"{symbol('δ_c')} = {fit.clearance.value * MM:.2f} ± {fit.clearance.spread * MM:.2f} mm",
        fontsize="small",
    )
    axes.set_xlabel("displacement (mm)")
    finish(axes, "force (N)")
    return figure


def _motion(run: FittedRun, prediction: RunPrediction, pitch: float) -> Figure:
    """Plot measured x1 and its prediction from the measured length."""
    time, x1 = run.traverse.time, run.traverse.x1
    residual = x1 - np.interp(time, prediction.time, prediction.x1)
    return motion_figure(
        _frame(run),
        [
            Curve("measured", time, x1, SAMPLES),
            Curve("predicted", prediction.time, prediction.x1, PREDICTED),
        ],
        [Curve("measured − predicted", time, residual, SAMPLES)],
        pitch,
    )


def _length(run: FittedRun, prediction: RunPrediction, slack: float) -> Figure:
    """Plot measured ΔL, its prediction from the command, and commanded and effective input."""
    recording = run.recording
    change = recording.length - run.length.initial_length
    time, command = recording.command_time, recording.command
    return length_figure(
        _frame(run),
        [
            Curve("measured", recording.camera_time, change, SAMPLES),
            Curve("predicted", recording.camera_time, prediction.length_change, PREDICTED),
        ],
        [
            Curve(COMMANDED_INPUT, time, command, COMMANDED),
            Curve(EFFECTIVE_INPUT, time, effective_command(command, slack), EFFECTIVE),
        ],
    )


def energy_of_run(run: FittedRun, prediction: RunPrediction) -> Figure:
    """Plot measured and predicted source power and energy, and the energy difference."""
    time, power = measured_power(run)
    expected = np.interp(time, prediction.time, prediction.energy)
    measured, expected = accumulated(time, power), expected - expected[:1]
    return energy_figure(
        _frame(run),
        [
            Curve("measured", time, power, MEASURED),
            Curve("predicted", prediction.time, prediction.power, PREDICTED),
        ],
        [
            Curve("measured", time, measured, MEASURED),
            Curve("predicted", time, expected, PREDICTED),
        ],
        [Curve("measured − predicted", time, measured - expected, MEASURED)],
    )


def _frame(run: FittedRun) -> Frame:
    gait = run.recording.gait
    title = f"{run.name}: S = {gait.stroke * MM:.0f} mm, f = {gait.frequency:g} Hz"
    return Frame(0.0, run.traverse.end, title=title)
