# SPDX-License-Identifier: Apache-2.0
"""Curves and figures of a recorded run with its twin, and of a simulated run; time 0 is the onset of the gait."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from worm_model.analysis import plot_style, run_plots
from worm_model.analysis.run_metrics import (
    Samples,
    accumulated_energy,
    averaged_cycles,
    last_played_gait,
)
from worm_model.analysis.run_plots import Curve, Curves, Frame
from worm_model.analysis.simulated_run import SimulatedRun
from worm_model.arrays import Array
from worm_model.gait import AVERAGED
from worm_model.parameters import Parameters
from worm_model.run import LengthSamples, Run, seconds
from worm_model.simulation.actuation import effective_command, length_change_of_command
from worm_model.twin.offline_replay import Replay, Series

TWIN = "twin, from the measured length"
_AROUND_S = 2.0  # time that an overview shows before the gait and after its last averaged cycle


def plot_run(run: Run, replay: Replay, parameters: Parameters, title: str = "") -> Figure:
    """Return a figure of the last gait of a run: x1, its residual, length change, power; averaged cycles are shaded.

    ``replay`` is a result of `worm_model.twin.offline_replay.replay_run`. Raises `RecordingError` without a gait.
    """
    played = last_played_gait(run.gait_state)
    window = played.cycle_window(*averaged_cycles(run, played))
    start, end = seconds(np.array([window.start, window.end]), played.onset)
    frame = Frame(-_AROUND_S, float(end) + _AROUND_S, (float(start), float(end)), title)
    positions, residuals = position_curves(run, replay, played.onset)
    lengths, _ = length_curves(run, played.onset, parameters)
    powers = power_curves(run, replay, played.onset)
    return run_plots.figure_of(
        frame,
        [
            run_plots.positions_panel(run_plots.X1, positions, parameters.pitch),
            run_plots.residuals_panel(residuals),
            run_plots.length_panel(lengths),
            run_plots.power_panel(powers),
        ],
    )


def plot_simulated_run(run: SimulatedRun) -> Figure:
    """Return a figure of the advance of both modules and anchors, the length change, the forces, and the power."""
    p, motions, time, period = run.parameters, run.motions, run.time, run.gait.period

    def curves(*rows: tuple[str, Array, plot_style.Style]) -> Curves:
        return [Curve(label, time, values, style) for label, values, style in rows]

    advances = curves(
        ("rear module x1", motions.x1, plot_style.MEASURED),
        ("front module x2 − L0", motions.x2 - p.initial_length, plot_style.PREDICTED),
        ("anchor A1", motions.rear_anchor, plot_style.CABLE),
        ("anchor A2 − A2(0)", motions.front_anchor - motions.front_anchor[0], plot_style.EFFECTIVE),
    )
    effective = effective_command(run.command, p.slack)
    lengths = curves(
        ("commanded", run.command, plot_style.COMMANDED),
        (plot_style.EFFECTIVE_INPUT, effective, plot_style.EFFECTIVE),
        ("realised", motions.length - p.initial_length, plot_style.MEASURED),
    )
    forces = curves(
        ("cable F_c", motions.cable_force, plot_style.MEASURED),
        ("rear fins F_1", motions.rear_force, plot_style.PREDICTED),
        ("front fins F_2", motions.front_force, plot_style.EFFECTIVE),
    )
    averaged = max(run.cycles - AVERAGED, 0) * period, run.cycles * period
    title = f"{1e3 * run.gait.stroke:g} mm at {run.gait.frequency:g} Hz"
    return run_plots.figure_of(
        Frame(0.0, float(time[-1]), averaged, title),
        [
            run_plots.positions_panel("advance (mm)", advances, p.pitch),
            run_plots.length_panel(lengths),
            run_plots.Panel("force (N)", forces),
            run_plots.power_panel(curves(("source power", motions.power, plot_style.MEASURED))),
        ],
    )


def position_curves(run: Run, replay: Replay, onset: int) -> tuple[Curves, Curves]:
    """Return (curves of x1, measured and of the twin; curve of the residual of x1).

    Times are relative to ``onset`` (ns), and x1 is relative to its measured value at the onset.
    """
    time = seconds(run.tracker.stamp, onset)
    rest = value_at_onset(time, run.tracker.rear_position)
    measured = Curve("measured", time, run.tracker.rear_position - rest, plot_style.MEASURED)
    twin = _of_twin(replay.states, "rear_position", onset, TWIN, plot_style.PREDICTED)
    twin = Curve(twin.label, twin.time, twin.values - rest, twin.style)
    return [measured, twin], [_residual(replay, "rear_position", onset)]


def length_curves(run: Run, onset: int, parameters: Parameters) -> tuple[Curves, Curves]:
    """Return (curves of the length changes of cable and body; curves of u_cmd and u_eff, eq:slack_clip).

    The length change of the body is shown as measured and as predicted from the command. A measured change is relative
    to the value of the same instrument at the onset (ns), which removes offsets.
    """
    time, command = seconds(run.commanded.stamp, onset), run.commanded.length_change
    time, command = time[time >= 0.0], command[time >= 0.0]
    predicted = length_change_of_command(time, command, parameters)
    lengths = [
        _change(run.cable, onset, "cable, from the encoder", plot_style.CABLE),
        _change(run.measured, onset, "body, measured", plot_style.MEASURED),
        Curve("body, predicted", time, predicted, plot_style.PREDICTED),
    ]
    inputs = [
        Curve(plot_style.COMMANDED_INPUT, time, command, plot_style.COMMANDED),
        Curve(
            plot_style.EFFECTIVE_INPUT,
            time,
            effective_command(command, parameters.slack),
            plot_style.EFFECTIVE,
        ),
    ]
    return [curve for curve in lengths if curve.time.size], inputs


def power_curves(run: Run, replay: Replay, onset: int) -> Curves:
    """Return the curves of the source power, measured and of the twin. The twin's curve begins at the onset (ns)."""
    known = np.isfinite(run.power.valid_power)
    measured = seconds(run.power.stamp[known], onset)
    stamp, power = settled_power(run, replay)
    time = seconds(stamp, onset)
    return [
        Curve("measured", measured, run.power.valid_power[known], plot_style.MEASURED),
        Curve(TWIN, time[time >= 0.0], power[time >= 0.0], plot_style.PREDICTED),
    ]


def energy_curves(run: Run, replay: Replay, onset: int) -> tuple[Curves, Curves]:
    """Return (curves of the energy since the onset (ns), measured and of the twin; curve of the residual)."""
    stamp, energy = accumulated_energy((run.power.stamp, run.power.valid_power))
    time = seconds(stamp, onset)
    measured = Curve("measured", time, energy - value_at_onset(time, energy), plot_style.MEASURED)
    twin = _of_twin(replay.states, "energy", onset, TWIN, plot_style.PREDICTED)
    return [measured, twin], [_residual(replay, "energy", onset)]


def settled_power(run: Run, replay: Replay) -> Samples:
    """Return (stamps, the twin's power in W) at the power samples for which the twin has a residual.

    The twin's power is the measured power minus the residual.
    """
    judged = np.isfinite(replay.residuals["power"])
    stamp, residual = replay.residuals["stamp_ns"][judged], replay.residuals["power"][judged]
    same, rows, of = np.intersect1d(run.power.stamp, stamp, return_indices=True)
    return same, run.power.valid_power[rows] - residual[of]


def value_at_onset(time: Array, values: Array) -> float:
    """Return the last known value up to the onset, otherwise the first one after it; NaN without known values."""
    known = np.isfinite(values)
    before = np.flatnonzero(known & (time <= 0.0))
    row = before[-1:] if before.size else np.flatnonzero(known)[:1]
    return float(values[row[0]]) if row.size else float("nan")


def _of_twin(series: Series, name: str, onset: int, label: str, style: plot_style.Style) -> Curve:
    """Return the curve of one of the twin's columns from the onset (ns) on, without unknown values."""
    time, values = seconds(series["stamp_ns"], onset), series[name]
    shown = np.isfinite(values) & (time >= 0.0)
    return Curve(label, time[shown], values[shown], style)


def _residual(replay: Replay, name: str, onset: int) -> Curve:
    return _of_twin(replay.residuals, name, onset, "measured − twin", plot_style.MEASURED)


def _change(samples: LengthSamples, onset: int, label: str, style: plot_style.Style) -> Curve:
    time = seconds(samples.stamp, onset)
    return Curve(label, time, samples.length - value_at_onset(time, samples.length), style)
