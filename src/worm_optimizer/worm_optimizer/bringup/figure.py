# SPDX-License-Identifier: Apache-2.0
"""The one figure of a run: where the robot went, how long it was, what it took; and the twin's view."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from worm_model.run import Run, seconds
from worm_model.twin_replay import Replay
from worm_optimizer.bringup.figures import Window

_ROBOT = {"color": "#1b6ca8", "linewidth": 1.4}
_TWIN = {"color": "#d1495b", "linewidth": 1.4, "linestyle": "--"}
_CABLE = {"color": "#7aa874", "linewidth": 1.0}
_COMMAND = {"color": "#c9c9c9", "linewidth": 3.5}


def draw_run(path: Path, title: str, run: Run, replay: Replay, window: Window) -> None:
    """Write the figure of a run as PNG; the averaged cycles are shaded."""
    figure = Figure(figsize=(11.0, 8.5), layout="constrained")
    figure.suptitle(title)
    position, length, power = figure.subplots(3, 1, sharex=True)
    twin = replay.states
    twin_time = seconds(twin["stamp_ns"], run.origin)

    tracker = seconds(run.tracker.stamp, run.origin)
    position.plot(tracker, 1e3 * run.tracker.rear_position, label="robot (tracker)", **_ROBOT)
    position.plot(twin_time, 1e3 * twin["rear_position"], label="twin (replayed)", **_TWIN)
    position.set_ylabel("rear module x1 in mm")

    for samples, label, style in (
        (run.commanded, "commanded", _COMMAND),
        (run.cable, "cable (encoder)", _CABLE),
        (run.measured, "body (measured)", _ROBOT),
        (run.estimated, "body (estimated)", _TWIN),
    ):
        length.plot(seconds(samples.stamp, run.origin), 1e3 * samples.length, label=label, **style)
    length.set_ylabel("length in mm")

    electric = seconds(run.power.stamp, run.origin)
    power.plot(electric, run.power.valid_power, label="robot (INA219)", **_ROBOT)
    power.plot(twin_time, twin["power"], label="twin (replayed)", **_TWIN)
    power.set_ylabel("source power in W")
    power.set_xlabel("time since the first sample in s")

    start, end = seconds(np.array([window.start, window.end]), run.origin)
    for axes in (position, length, power):
        _finish(axes, start, end)
    figure.savefig(path, dpi=130)


def _finish(axes: Axes, start: float, end: float) -> None:
    axes.axvspan(start, end, color="#f4e8c1", zorder=0, label="averaged cycles")
    axes.grid(visible=True, linewidth=0.4)
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize="small", frameon=False)
