# SPDX-License-Identifier: Apache-2.0
"""The one figure of a run: where the robot went, how long it was, what it took; and the twin's view."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from worm_model.run import Run, seconds
from worm_model.twin.offline_replay import Replay
from worm_optimizer.operation.gait_figures import Window, averaged_onset, settled_power
from worm_optimizer.report.style import (
    CABLE,
    COMMANDED,
    MEASURED,
    PREDICTED,
    finish,
    new_figure,
    shade,
)

_AROUND_S = 2.0  # of rest before and after the gait that are shown


def draw_run(path: Path, title: str, run: Run, replay: Replay, window: Window) -> None:
    """Write the figure of a run's last gait as PNG; the averaged cycles are shaded."""
    figure = new_figure(10.0, 8.6)
    figure.suptitle(title)
    position, length, power = figure.subplots(3, 1, sharex=True)
    onset = averaged_onset(run.gait_state)
    start, end = seconds(np.array([window.start, window.end]), onset)

    _draw_position(position, run, replay, onset)
    _draw_length(length, run, replay, onset)
    _draw_power(power, run, replay, onset)
    power.set_xlabel("time since the gait's onset (s)")
    shade(position, start, end)
    for axes, label in (
        (position, "rear module x1 (mm)"),
        (length, "length (mm)"),
        (power, "source power (W)"),
    ):
        if axes is not position:
            shade(axes, start, end, label="")
        axes.set_xlim(-_AROUND_S, end + _AROUND_S)
        finish(axes, label)
    figure.align_ylabels()
    figure.savefig(path, dpi=120)


def _draw_position(axes: Axes, run: Run, replay: Replay, onset: int) -> None:
    tracker = run.tracker
    time = seconds(tracker.stamp, onset)
    axes.plot(time, 1e3 * tracker.rear_position, label="robot, by its tracker", **MEASURED)
    states = replay.states
    seen = states["stamp_ns"] >= tracker.stamp[:1].max(initial=0)  # before, its zero is its own
    time = seconds(states["stamp_ns"][seen], onset)
    axes.plot(
        time, 1e3 * states["rear_position"][seen], label="twin, by the measured length", **PREDICTED
    )


def _draw_length(axes: Axes, run: Run, replay: Replay, onset: int) -> None:
    for samples, label, style in (
        (run.commanded, "cable, commanded", COMMANDED),
        (run.cable, "cable, by the encoder", CABLE),
        (run.measured, "body, by the tracker", MEASURED),
    ):
        axes.plot(seconds(samples.stamp, onset), 1e3 * samples.length, label=label, **style)
    time = seconds(replay.lengths["stamp_ns"], onset)
    length = 1e3 * replay.lengths["length"]
    axes.plot(time, length, label="body, twin by the command", **PREDICTED)


def _draw_power(axes: Axes, run: Run, replay: Replay, onset: int) -> None:
    time = seconds(run.power.stamp, onset)
    axes.plot(time, run.power.valid_power, label="robot, by its power sensor", **MEASURED)
    stamp, power = settled_power(run, replay)
    axes.plot(seconds(stamp, onset), power, label="twin, by the measured length", **PREDICTED)
    axes.set_ylim(bottom=0.0)
