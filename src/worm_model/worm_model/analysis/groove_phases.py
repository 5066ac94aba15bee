# SPDX-License-Identifier: Apache-2.0
"""Map of the grooves per cycle by stroke and groove phase, and the margin's cliff as a function of the phase.

The map shows the effect of adjusting L0. A change of L0 by millimetres shifts the groove phase by the same amount. The
shift changes the cliff of the margin, and the smallest strokes with which a cycle gains one, two or more grooves.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass

import numpy as np
from matplotlib.figure import Figure

from worm_model.analysis import plot_style
from worm_model.arrays import Array
from worm_model.gait import Gait
from worm_model.parameters import Parameters
from worm_model.simulation.batch import evaluate_gaits
from worm_model.simulation.closed_form import cliff_margin, front_groove, groove_phase


@dataclass(frozen=True)
class PhaseMap:
    """Grooves per cycle and cliff of the margin, as functions of the groove phase.

    Attributes:
        frequency: frequency of all gaits, Hz.
        stroke: strokes (n,), m.
        phase: groove phases (m,), m.
        grooves: grooves per cycle (m, n); rows are phases, columns are strokes.
        cliff: closed-form cliff of the margin with each phase (m,), m.
        phase_now: groove phase with the L0 of the parameters, m.
        cliff_now: closed-form cliff of the margin with the L0 of the parameters, m.
    """

    frequency: float
    stroke: Array
    phase: Array
    grooves: Array
    cliff: Array
    phase_now: float
    cliff_now: float


def compute_phase_map(
    parameters: Parameters,
    gait: Gait,
    stroke: Array,
    phase: Array,
    progress: Callable[[float], None] | None = None,
) -> PhaseMap:
    """Simulate a gait with each stroke of ``stroke`` (n,) in m at each groove phase of ``phase`` (m,) in m.

    Each phase is obtained by a change of L0 alone. ``progress`` is called with the fraction done, 0 to 1.
    """
    groove = front_groove(parameters)
    lengths = groove * parameters.pitch + phase
    table = evaluate_gaits(
        **{**asdict(gait), "stroke": stroke[np.newaxis, :]},
        parameters=parameters,
        overrides={"initial_length": lengths[:, np.newaxis]},
        progress=progress,
    )
    further = gait.direction, gait.pretension
    cliff = [cliff_margin(parameters.replace(initial_length=each), *further) for each in lengths]
    return PhaseMap(
        gait.frequency,
        stroke,
        phase,
        np.round(table.grooves_per_cycle),
        np.array(cliff),
        groove_phase(parameters),
        cliff_margin(parameters, *further),
    )


def phase_map_figure(content: PhaseMap) -> Figure:
    """Return a figure with the map of the grooves per cycle and, next to it, the cliff for each groove phase."""
    figure = plot_style.new_figure(10.5, 4.5)
    left, right = figure.subplots(1, 2, sharey=True, width_ratios=(3, 2))
    plot_style.draw_groove_map(
        left, plot_style.MM * content.stroke, plot_style.MM * content.phase, content.grooves
    )
    left.set(xlabel="stroke S (mm)", ylabel="groove phase φ (mm)")
    left.set_title(f"grooves per cycle at {content.frequency:g} Hz", loc="left", fontsize="small")
    now = plot_style.MM * content.phase_now
    right.plot(plot_style.MM * content.cliff, plot_style.MM * content.phase, color=plot_style.BLUE)
    right.axvline(0.0, color=plot_style.GREY, linewidth=0.8)
    right.plot(
        plot_style.MM * content.cliff_now,
        now,
        "o",
        color=plot_style.VERMILION,
        label=f"now: φ = {now:.2f} mm, {plot_style.MARGIN_SYMBOL}* = {plot_style.MM * content.cliff_now:.2f} mm",
    )
    right.set(xlabel=f"cliff of the margin {plot_style.MARGIN_SYMBOL}* (mm), closed form")
    for axes in (left, right):
        axes.axhline(now, color=plot_style.VERMILION, linestyle="--", linewidth=1.2)
    right.margins(x=0.08)
    right.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), fontsize="small", frameon=False)
    plot_style.letter((left, right))
    return figure
