# SPDX-License-Identifier: Apache-2.0
"""The paper's figures of a run: x1, length change and inputs, power and energy over five ridges; and its cycles."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MultipleLocator

from worm_model.run import LengthSamples, seconds
from worm_model.simulation.actuation import effective_command, length_change_of_command
from worm_model.simulation.simulator import simulate
from worm_model.twin.offline_replay import Series
from worm_optimizer.operation.gait_figures import accumulate, settled_power
from worm_optimizer.report.recorded import RecordedGait
from worm_optimizer.report.style import (
    CABLE,
    COMMANDED,
    EFFECTIVE,
    MEASURED,
    PREDICTED,
    finish,
    new_figure,
    shade,
)

RIDGES = 5  # that the paper's runs traverse
_BEFORE = 1.0  # s of rest that the figures begin with
_MODEL_SAMPLES = 2000
_TIME = "time since the gait's onset (s)"


def draw_motion(gait: RecordedGait) -> Figure:
    """x1 as the tracker saw it and as the twin says under the recorded length, and the difference."""
    figure = new_figure(10.0, 5.4)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
    tracker = gait.run.tracker
    measured = _since_onset(gait, tracker.stamp)
    start = _at_onset(measured, tracker.rear_position)
    seen = measured >= -_BEFORE  # it may have come from far away
    above.plot(
        measured[seen], 1e3 * (tracker.rear_position[seen] - start), label="measured", **MEASURED
    )
    followed, position = _of_run(gait, gait.replay.states, "rear_position")
    above.plot(followed, 1e3 * (position - start), label="twin, measured L", **PREDICTED)
    compared, residual = _of_run(gait, gait.replay.residuals, "rear_position")
    below.plot(compared, 1e3 * residual, label="measured − twin", **MEASURED)
    _frame(gait, (above, below), ("rear module x1 (mm)", "residual (mm)"))
    above.grid(visible=False, axis="y")
    above.yaxis.set_minor_locator(MultipleLocator(1e3 * gait.content.parameters.pitch))
    above.grid(visible=True, axis="y", which="minor", linewidth=0.4)
    above.tick_params(axis="y", which="minor", length=0)
    above.set_title("horizontal lines: the pipe's ridges", loc="right", fontsize="small")
    return figure


def draw_length(gait: RecordedGait) -> Figure:
    """ΔL measured and predicted from the command alone, with the inputs u_cmd and u_eff (paper: eq:slack_clip)."""
    figure = new_figure(10.0, 5.4)
    above, below = figure.subplots(2, 1, sharex=True)
    run, parameters = gait.run, gait.content.parameters
    commanded = run.commanded
    time = _since_onset(gait, commanded.stamp)
    played = time >= 0.0
    time, command = time[played], commanded.length_change[played]
    predicted = length_change_of_command(time, command, parameters)
    for samples, label, style in (
        (run.cable, "cable, by the encoder", CABLE),
        (run.measured, "body, measured", MEASURED),
    ):
        above.plot(
            _since_onset(gait, samples.stamp), 1e3 * _change(gait, samples), label=label, **style
        )
    above.plot(time, 1e3 * predicted, label="body, predicted", **PREDICTED)
    below.plot(time, 1e3 * command, label="u_cmd", **COMMANDED)
    below.plot(time, 1e3 * effective_command(command, parameters.slack), label="u_eff", **EFFECTIVE)
    _frame(gait, (above, below), ("length change ΔL (mm)", "input (mm)"))
    return figure


def draw_energy(gait: RecordedGait) -> Figure:
    """Source power and accumulated energy, measured and predicted, until five ridges are passed."""
    figure = new_figure(10.0, 5.4)
    above, below = figure.subplots(2, 1, sharex=True)
    twin = {**PREDICTED, "label": "twin, measured L"}
    power, stamp = gait.run.power.valid_power, gait.run.power.stamp
    known = np.isfinite(power)
    above.plot(_since_onset(gait, stamp[known]), power[known], label="measured", **MEASURED)
    settled, predicted = settled_power(gait.run, gait.replay)
    above.plot(_since_onset(gait, settled), predicted, **twin)
    stamp, energy = accumulate(stamp, power)
    time = _since_onset(gait, stamp)
    below.plot(time, energy - _at_onset(time, energy), label="measured", **MEASURED)
    below.plot(*_of_run(gait, gait.replay.states, "energy"), **twin)
    _plot_model(gait, above, below)
    passed = ridges_passed_at(gait)
    end = passed if np.isfinite(passed) else _duration(gait)
    _frame(gait, (above, below), ("source power (W)", "energy (J)"), end)
    for axes in (above, below):
        _fit_height(axes, end)
    what = "until five ridges are passed" if np.isfinite(passed) else "five ridges are not passed"
    above.set_title(what, loc="right", fontsize="small")
    return figure


def _plot_model(gait: RecordedGait, power: Axes, energy: Axes) -> None:
    """What the model says of the command alone, without any measurement."""
    trajectory = simulate(gait.expected.nominal.gait, gait.content.parameters, gait.cycles)
    time = np.linspace(0.0, trajectory.duration, _MODEL_SAMPLES)
    model = trajectory.at(time)
    power.plot(time, model.power, label="model, command alone", **EFFECTIVE)
    energy.plot(time, model.energy, label="model, command alone", **EFFECTIVE)


def draw_cycles(gait: RecordedGait) -> Figure:
    """Grooves and rms residuals of each cycle."""
    figure = new_figure(10.0, 3.2)
    axes = figure.subplots(1, 4)
    cycles = gait.judged.cycles
    numbers = np.arange(1, len(cycles) + 1)
    axes[0].bar(
        numbers - 0.2, [c.measured_grooves for c in cycles], 0.4, color=MEASURED["color"], label="measured"
    )  # fmt: skip
    axes[0].bar(
        numbers + 0.2, [c.grooves for c in cycles], 0.4, color=PREDICTED["color"], hatch="//", label="twin"
    )  # fmt: skip
    axes[0].legend(
        fontsize="small", loc="upper center", ncols=2, bbox_to_anchor=(0.5, 1.17), frameon=False
    )
    axes[0].set_ylabel("grooves gained (1)")
    for row, name, scale, unit in (
        (axes[1], "x1_rmse", 1e3, "x1 residual (mm rms)"),
        (axes[2], "length_rmse", 1e3, "length residual (mm rms)"),
        (axes[3], "power_rmse", 1.0, "power residual (W rms)"),
    ):
        row.bar(
            numbers, [scale * getattr(c.residuals, name) for c in cycles], color=MEASURED["color"]
        )
        row.set_ylabel(unit)
    for row in axes:
        row.set_xlabel("cycle")
        row.set_xticks(numbers)
        row.grid(visible=True, axis="y", linewidth=0.4)
        row.set_axisbelow(True)
    return figure


RUN_FIGURES: Mapping[str, tuple[Callable[[RecordedGait], Figure], str]] = {
    "motion": (
        draw_motion,
        "Position of the rear module: measured, and the twin's under the measured length.",
    ),
    "length": (
        draw_length,
        "Length change: measured, and predicted from the command through slack and lag; with the commanded and the "
        "effective input.",
    ),
    "energy": (draw_energy, "Source power and accumulated energy over the first five ridges."),
    "cycles": (
        draw_cycles,
        "Grooves gained and residuals against the twin, cycle by cycle.",
    ),
}


def ridges_passed_at(gait: RecordedGait) -> float:
    """S since the onset at which the rear module had advanced five ridges, NaN if it did not."""
    tracker = gait.run.tracker
    time = _since_onset(gait, tracker.stamp)
    start = _at_onset(time, tracker.rear_position)
    advance = gait.gait.direction * (tracker.rear_position - start)
    past = np.flatnonzero((time > 0.0) & (advance >= RIDGES * gait.content.parameters.pitch))
    return float(time[past[0]]) if past.size else float("nan")


def _since_onset(gait: RecordedGait, stamps: np.ndarray) -> np.ndarray:
    return seconds(stamps, gait.onset)


def _of_run(gait: RecordedGait, series: Series, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Times since the onset (s) and known values of one of the twin's columns, within the run that began there."""
    time, values = _since_onset(gait, series["stamp_ns"]), series[name]
    shown = np.isfinite(values) & (time >= 0.0)
    return time[shown], values[shown]


def _duration(gait: RecordedGait) -> float:
    return gait.cycles * gait.gait.period


def _at_onset(time: np.ndarray, values: np.ndarray) -> float:
    """The last known value before the onset, else the first one after it; NaN if there is none."""
    known = np.isfinite(values)
    before = np.flatnonzero(known & (time <= 0.0))
    row = before[-1:] if before.size else np.flatnonzero(known)[:1]
    return float(values[row[0]]) if row.size else float("nan")


def _change(gait: RecordedGait, samples: LengthSamples) -> np.ndarray:
    """Length change in m from what the same instrument saw at rest, so that no length offset shows."""
    return samples.length - _at_onset(_since_onset(gait, samples.stamp), samples.length)


def _frame(
    gait: RecordedGait,
    panels: tuple[Axes, ...],
    labels: tuple[str, ...],
    until: float = float("nan"),
) -> None:
    """Axes from the rest before the onset to ``until`` s, NaN: to a little after the gait."""
    start, end = _since_onset(gait, np.array([gait.window.start, gait.window.end]))
    last = until if np.isfinite(until) else _duration(gait) + _BEFORE
    for axes, label in zip(panels, labels, strict=True):
        if start < last:
            shade(axes, start, end, label="averaged cycles" if axes is panels[0] else "")
        finish(axes, label)
        axes.set_xlim(-_BEFORE, last)
    panels[-1].set_xlabel(_TIME)
    panels[0].figure.align_ylabels()


def _fit_height(axes: Axes, end: float) -> None:
    """Fits the height to what is seen until ``end`` s."""
    seen = [
        np.asarray(line.get_ydata())[np.asarray(line.get_xdata()) <= end]
        for line in axes.get_lines()
    ]
    values = np.concatenate([part[np.isfinite(part)] for part in seen])
    if values.size:
        axes.set_ylim(0.0, 1.08 * float(values.max()))
