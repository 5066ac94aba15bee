# SPDX-License-Identifier: Apache-2.0
"""The figures of the paper's Section V: bench fits, and x1, ΔL, power and energy of every run."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from worm_model.identification.bellows import BellowsFit
from worm_model.identification.fin import FinFit
from worm_model.identification.run_prediction import Prediction, measured_power, predict
from worm_model.identification.stages import Identification, Run
from worm_model.simulation.actuation import effective_command
from worm_model.simulation.quadrature import accumulated

Array = NDArray[np.float64]

# Okabe and Ito's palette: told apart by colour-blind readers; the line style says it a second time.
MEASURED: dict[str, Any] = {"color": "#0072B2", "linewidth": 1.6}
SEEN: dict[str, Any] = {"color": "#0072B2", "linestyle": "none", "marker": ".", "markersize": 3}
PREDICTED: dict[str, Any] = {"color": "#D55E00", "linewidth": 1.6, "linestyle": "--"}
COMMANDED: dict[str, Any] = {"color": "#999999", "linewidth": 1.6}
EFFECTIVE: dict[str, Any] = {"color": "#009E73", "linewidth": 1.6, "linestyle": "-."}
MM = 1e3  # mm per m
WIDTH = 6.4  # inches


def all_figures(result: Identification) -> Iterator[tuple[str, Figure]]:
    """(name, figure) one after the other, so that only one is in memory."""
    if result.bellows is not None:
        yield "bellows", bellows_figure(result.bellows)
    if result.fin is not None:
        yield "fin", fin_figure(result.fin)
    yield "search", search_figure(result)
    offset = float(result.actuation.fit.clock_offset.mean())
    for run in result.runs:
        prediction = predict(run.recording, run.traverse, result.parameters, offset)
        yield f"{run.name}_motion", motion_figure(run, prediction)
        yield f"{run.name}_length", length_figure(run, prediction, result.parameters.slack)
        yield f"{run.name}_energy", energy_figure(run, prediction)


def bellows_figure(fit: BellowsFit) -> Figure:
    """Force over compression and the line through it."""
    figure, (axes,) = _figure(1, 3.2)
    axes.plot(fit.compression * MM, fit.force, **SEEN, label="measured")
    ends = np.array([0.0, fit.compression.max()])
    label = f"k_b = {fit.stiffness.value:.1f} ± {fit.stiffness.spread:.1f} N/m"
    axes.plot(ends * MM, fit.offset + fit.stiffness.value * ends, **PREDICTED, label=label)
    axes.set_xlabel("compression (mm)")
    return _finished(figure, [(axes, "force (N)")])


def fin_figure(fit: FinFit) -> Figure:
    """Force over displacement and the broken line, its knees marked."""
    figure, (axes,) = _figure(1, 3.4)
    axes.plot(fit.displacement * MM, fit.force, **SEEN, label="measured")
    grid = np.linspace(fit.displacement.min(), fit.displacement.max(), 400)
    axes.plot(grid * MM, fit.force_at(grid), **PREDICTED, label="fitted")
    for sign in (-1.0, 1.0):
        knee = fit.centre + 0.5 * sign * fit.clearance.value
        axes.axvline(knee * MM, color="#999999", linewidth=0.8, linestyle=":")
    axes.set_title(
        f"k_eng = {fit.engaged_stiffness.value:.0f} ± {fit.engaged_stiffness.spread:.0f} N/m, "
        f"k_dis = {fit.disengaged_stiffness.value:.0f} ± {fit.disengaged_stiffness.spread:.0f} N/m, "
        f"δ_c = {fit.clearance.value * MM:.2f} ± {fit.clearance.spread * MM:.2f} mm",
        fontsize="small",
    )
    axes.set_xlabel("displacement (mm)")
    return _finished(figure, [(axes, "force (N)")])


def search_figure(result: Identification) -> Figure:
    """J_loc over the switching threshold: the least over all frictions of the grid, and where the fit ended."""
    landscape = result.locomotion.landscape
    figure, (axes,) = _figure(1, 3.2)
    best = np.sqrt(landscape.cost.min(axis=0)) * MM
    axes.semilogy(landscape.threshold * MM, best, **MEASURED, label="least over η, no dry friction")
    estimate = result.locomotion.switching_threshold
    axes.axvspan(
        estimate.low * MM,
        estimate.high * MM,
        color="#D55E00",
        alpha=0.5,
        label=f"p_sw = {estimate.value * MM:.2f} ± {estimate.spread * MM:.2f} mm",
    )
    axes.set_xlabel("switching threshold p_sw (mm)")
    return _finished(figure, [(axes, "error of x1, r.m.s. (mm)")])


def motion_figure(run: Run, prediction: Prediction) -> Figure:
    """x1 measured, and predicted under the measured length."""
    figure, axes = _figure(2, 4.2, (3.0, 1.0))
    traverse = run.traverse
    axes[0].plot(traverse.time, traverse.x1 * MM, **SEEN, label="measured")
    shown = prediction.time <= traverse.end
    axes[0].plot(prediction.time[shown], prediction.x1[shown] * MM, **PREDICTED, label="predicted")
    axes[0].set_title(_title(run), fontsize="small")
    left = traverse.x1 - np.interp(traverse.time, prediction.time, prediction.x1)
    axes[1].plot(traverse.time, left * MM, **SEEN)
    axes[1].set_xlabel("time since the onset (s)")
    return _finished(figure, [(axes[0], "x1 (mm)"), (axes[1], "error (mm)")])


def length_figure(run: Run, prediction: Prediction, slack: float) -> Figure:
    """(a) ΔL measured and predicted from the command; (b) commanded and effective input."""
    figure, axes = _figure(2, 4.6)
    recording = run.recording
    shown = (recording.camera_time >= 0.0) & (recording.camera_time <= run.traverse.end)
    time = recording.camera_time[shown]
    change = recording.length[shown] - run.length.initial_length
    axes[0].plot(time, change * MM, **SEEN, label="measured")
    axes[0].plot(time, prediction.length_change[shown] * MM, **PREDICTED, label="predicted")
    axes[0].set_title(_title(run), fontsize="small")
    commanded = recording.command_time <= run.traverse.end
    time, command = recording.command_time[commanded], recording.command[commanded]
    axes[1].plot(time, command * MM, **COMMANDED, label="u_cmd")
    axes[1].plot(time, effective_command(command, slack) * MM, **EFFECTIVE, label="u_eff")
    axes[1].set_xlabel("time since the onset (s)")
    return _finished(figure, [(axes[0], "ΔL (mm)"), (axes[1], "input (mm)")])


def energy_figure(run: Run, prediction: Prediction) -> Figure:
    """(a) source power and (b) accumulated energy, measured and predicted; (c) measured less predicted energy."""
    figure, axes = _figure(3, 5.6, (2.0, 2.0, 1.0))
    time, power = measured_power(run.recording, run.traverse)
    axes[0].plot(time, power, **MEASURED, label="measured")
    predicted = np.interp(time, prediction.time, prediction.power)
    axes[0].plot(time, predicted, **PREDICTED, label="predicted")
    axes[0].set_title(_title(run), fontsize="small")
    axes[2].set_xlabel("time since the onset (s)")
    labels = [(axes[0], "power (W)"), (axes[1], "energy (J)"), (axes[2], "error (J)")]
    if time.size:
        measured = accumulated(time, power)
        energy = np.interp(time, prediction.time, prediction.energy)
        axes[1].plot(time, measured, **MEASURED, label="measured")
        axes[1].plot(time, energy - energy[0], **PREDICTED, label="predicted")
        axes[2].plot(time, measured - (energy - energy[0]), **MEASURED)
    return _finished(figure, labels)


def _title(run: Run) -> str:
    gait = run.recording.gait
    return f"{run.name}: S = {gait.stroke * MM:.0f} mm, f = {gait.frequency:g} Hz"


def _figure(
    rows: int, height: float, ratios: tuple[float, ...] | None = None
) -> tuple[Figure, list[Axes]]:
    figure = Figure(figsize=(WIDTH, height), layout="constrained")
    axes = figure.subplots(rows, 1, sharex=rows > 1, height_ratios=ratios)
    return figure, list(np.atleast_1d(axes))


def _finished(figure: Figure, labels: list[tuple[Axes, str]]) -> Figure:
    for axes, label in labels:
        axes.set_ylabel(label)
        axes.grid(visible=True, linewidth=0.4)
        axes.margins(x=0.01)
        if axes.get_legend_handles_labels()[0]:
            axes.legend(fontsize="small", frameon=False, loc="best")
    figure.align_ylabels()
    return figure
