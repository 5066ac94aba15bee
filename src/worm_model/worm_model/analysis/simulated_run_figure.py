# SPDX-License-Identifier: Apache-2.0
"""Figure of a simulated gait."""

from __future__ import annotations

from matplotlib.figure import Figure

from worm_model.analysis.plot_style import (
    CABLE,
    COMMANDED,
    EFFECTIVE,
    EFFECTIVE_INPUT,
    MEASURED,
    PREDICTED,
)
from worm_model.analysis.run_plots import Curve, Frame, simulation_figure
from worm_model.analysis.simulated_run import SimulatedRun
from worm_model.simulation.actuation import effective_command
from worm_model.simulation.simulator import AVERAGED


def figure_of(run: SimulatedRun) -> Figure:
    """Return a figure of both modules and anchors relative to their start, length, forces and power."""
    p, motions, time, period = run.parameters, run.motions, run.time, run.gait.period
    front = motions.front_anchor[0]
    averaged = max(run.cycles - AVERAGED, 0) * period, run.cycles * period
    title = f"{1e3 * run.gait.stroke:g} mm at {run.gait.frequency:g} Hz"
    return simulation_figure(
        Frame(0.0, float(time[-1]), averaged, title),
        [
            Curve("rear module x1", time, motions.x1, MEASURED),
            Curve("front module x2 − L0", time, motions.x2 - p.initial_length, PREDICTED),
            Curve("anchor A1", time, motions.rear_anchor, CABLE),
            Curve("anchor A2 − A2(0)", time, motions.front_anchor - front, EFFECTIVE),
        ],
        [
            Curve("commanded", time, run.command, COMMANDED),
            Curve(EFFECTIVE_INPUT, time, effective_command(run.command, p.slack), EFFECTIVE),
            Curve("realised", time, motions.length - p.initial_length, MEASURED),
        ],
        [
            Curve("cable F_c", time, motions.cable_force, MEASURED),
            Curve("rear fins F_1", time, motions.rear_force, PREDICTED),
            Curve("front fins F_2", time, motions.front_force, EFFECTIVE),
        ],
        [Curve("source power", time, motions.power, MEASURED)],
        p.pitch,
    )
