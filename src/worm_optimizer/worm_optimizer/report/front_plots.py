# SPDX-License-Identifier: Apache-2.0
"""Figures of fronts with marked or measured gaits, of their groove map, and of the price of robustness."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from worm_model.analysis.plot_style import (
    BLACK,
    LIGHT_GREY,
    MARGIN_SYMBOL,
    MM,
    PURPLE,
    branch_style,
    draw_groove_map,
    legend_above,
    letter,
    new_figure,
)
from worm_optimizer.evaluation.task import Array, MarginTask
from worm_optimizer.report.agreement import title_of
from worm_optimizer.report.expectation import Band, Bands
from worm_optimizer.report.recorded_gait import RecordedGait
from worm_optimizer.robustness.prediction import Prediction
from worm_optimizer.search.front import RobustFront
from worm_optimizer.search.price_of_robustness import PriceOfRobustness

_MAP_STROKES, _MAP_FREQUENCIES = 241, 161
_COSTS = (25, 50, 100, 200)  # cost of transport of each line in the plane of speed and power

# The measured value usually lies within the expected interval, so a small filled marker is drawn in a large hollow one.
_EXPECTED: Mapping[str, Any] = {
    "color": PURPLE,
    "marker": "s",
    "markersize": 13,
    "markerfacecolor": "none",
    "markeredgewidth": 1.5,
    "label": "expected (95 %)",
}
_MEASURED: Mapping[str, Any] = {
    "color": BLACK,
    "marker": "*",
    "markersize": 8,
    "label": "measured (span of cycles)",
}


def front_figure(front: RobustFront, marks: Mapping[str, Prediction]) -> Figure:
    """Draw a front with marked gaits and their cost of transport."""
    figure = new_figure(6.5, 5.0)
    axes = figure.subplots()
    _plot_front(axes, front)
    _mark(axes, marks)
    legend_above(axes, 2)
    return figure


def front_and_map_figure(front: RobustFront, marks: Mapping[str, Prediction]) -> Figure:
    """Draw a front next to the map of the grooves per cycle, at the margin of the front."""
    task = front.nominal.with_margin(front.margin)
    figure = new_figure(12.5, 5.0)
    left, right = figure.subplots(1, 2)
    _plot_front(left, front)
    _mark(left, marks)
    legend_above(left, 2)
    _plot_map(right, task)
    strokes, frequencies = _columns(front.gaits, "stroke", "frequency")
    outlined = {"color": "white", "markeredgecolor": BLACK, "linestyle": "none"}
    right.plot(MM * strokes, frequencies, marker=".", label="front", **outlined)
    strokes, frequencies = _columns(tuple(marks.values()), "stroke", "frequency")
    right.plot(
        MM * strokes, frequencies, marker="*", markersize=15, label="marked gaits", **outlined
    )
    right.set_title(
        f"grooves per cycle at {MARGIN_SYMBOL} = {MM * task.margin:.2f} mm",
        loc="left",
        fontsize="small",
    )
    legend_above(right)
    letter((left, right))
    return figure


def measured_front_figure(front: RobustFront, gaits: Sequence[RecordedGait]) -> Figure:
    """Draw the front with the measured (span of cycles) and expected (95 %) values of recorded gaits."""
    figure = new_figure(8.5, 6.2)
    axes = figure.subplots()
    _plot_front(axes, front)
    for gait in gaits:
        _cross(axes, gait.expected.bands, _EXPECTED)
        _cross(axes, gait.measured, _MEASURED)
    fastest = max(
        [axes.get_xlim()[1], *(1.2 * MM * g.measured.speed.value for g in gaits)], key=_or_zero
    )
    most = max([axes.get_ylim()[1], *(1.15 * g.measured.power.value for g in gaits)], key=_or_zero)
    axes.set(xlim=(0.0, fastest), ylim=(0.0, most))
    for gait in gaits:
        _name(
            axes,
            f"{title_of(gait.name)}, COT {gait.measured.cost_of_transport.value:.1f}",
            (MM * gait.measured.speed.value, gait.measured.power.value),
        )
    handles, _ = axes.get_legend_handles_labels()
    handles += [Line2D([], [], linestyle="none", **style) for style in (_EXPECTED, _MEASURED)]
    axes.legend(
        handles=handles,
        loc="lower right",
        bbox_to_anchor=(1.0, 1.0),
        ncols=3,
        fontsize="small",
        frameon=False,
    )
    return figure


def price_figure(price: PriceOfRobustness) -> Figure:
    """Draw the lowest cost of transport over the margin by branches, with the cliff and its closed form."""
    figure = new_figure(7.5, 4.8)
    axes = figure.subplots()
    margins = MM * np.array([point.margin for point in price.points])
    costs = np.array([point.cost_of_transport for point in price.points])
    branches = np.array([point.branch for point in price.points])
    axes.plot(margins, costs, color=LIGHT_GREY, linewidth=1.0)
    for branch in np.unique(branches[branches > 0])[::-1]:
        rows = branches == branch
        axes.plot(margins[rows], costs[rows], **branch_style(int(branch)))
    if price.cliff is not None:
        cliff = MM * price.cliff.margin
        axes.axvline(cliff, color=BLACK, label=f"cliff: {cliff:.2f} mm")
    closed_form = MM * price.closed_form_cliff_margin
    axes.axvline(
        closed_form, color=BLACK, linestyle=":", label=f"closed form: {closed_form:.2f} mm"
    )
    axes.set(
        xlabel=f"robustness margin {MARGIN_SYMBOL} (mm)",
        ylabel="lowest cost of transport (1)",
        ylim=(0.0, None),
    )
    axes.set_title(f"φ = {MM * price.groove_phase:+.2f} mm", loc="left", fontsize="small")
    legend_above(axes, 2)
    return figure


def _plot_front(axes: Axes, front: RobustFront) -> None:
    """Draw a front as power over speed, by branches, with lines of equal cost of transport."""
    speed, power, grooves, cost = _columns(
        front.gaits, "speed", "power", "grooves_per_cycle", "cost_of_transport"
    )
    for branch in np.unique(np.round(grooves).astype(int)):
        rows = np.round(grooves) == branch
        axes.plot(MM * speed[rows], power[rows], **branch_style(int(branch)))
    axes.set_xlim(0.0, 1.12 * MM * speed.max())
    axes.set_ylim(0.0, 1.2 * power.max())
    _cost_lines(axes, power[0] / (cost[0] * speed[0]))
    axes.set(xlabel="mean speed along the gait's direction (mm/s)", ylabel="mean source power (W)")
    margin, phase = MM * front.margin, MM * front.gaits[0].groove_phase
    axes.set_title(
        f"{MARGIN_SYMBOL} = {margin:.2f} mm, φ = {phase:+.2f} mm", loc="left", fontsize="small"
    )


def _mark(axes: Axes, marks: Mapping[str, Prediction]) -> None:
    for name, gait in marks.items():
        axes.plot(MM * gait.speed, gait.power, "*", color=BLACK, markersize=13)
        text = f"{name.replace('_', ' ')}, COT {gait.cost_of_transport:.1f}"
        _name(axes, text, (MM * gait.speed, gait.power))


def _name(axes: Axes, text: str, point: tuple[float, float]) -> None:
    """Label a point, to its lower right or, near the right end of the axes, to its upper left.

    The front does not pass through these regions. The label has a white background.
    """
    right_end = point[0] > 0.75 * axes.get_xlim()[1]
    axes.annotate(
        text,
        point,
        textcoords="offset points",
        xytext=(-14.0, 12.0) if right_end else (14.0, -22.0),
        ha="right" if right_end else "left",
        fontsize="small",
        bbox={"boxstyle": "round,pad=0.15", "facecolor": "white", "edgecolor": "none"},
        arrowprops={"arrowstyle": "-", "color": BLACK, "linewidth": 0.6},
        zorder=4,
    )


def _cost_lines(axes: Axes, weight: float) -> None:
    """Draw lines of equal cost of transport, P = COT · m·g · v, with a label below their ends."""
    fastest, most = axes.get_xlim()[1], axes.get_ylim()[1]
    for cost in _COSTS:
        slope = cost * weight / MM  # W per mm/s
        end = min(fastest, most / slope)
        axes.plot([0.0, end], [0.0, slope * end], color=LIGHT_GREY, linewidth=0.8, zorder=0)
        axes.annotate(
            f"COT {cost}",
            (end, slope * end),
            textcoords="offset points",
            xytext=(-2, -12),
            ha="right" if slope * end < most else "left",
            color="0.4",
            fontsize=8,
        )


def _plot_map(axes: Axes, task: MarginTask) -> None:
    box = task.bounds
    strokes = np.linspace(box.stroke_low, box.stroke_high, _MAP_STROKES)
    frequencies = np.linspace(box.frequency_low, box.frequency_high, _MAP_FREQUENCIES)
    grooves = task.grooves(strokes[np.newaxis, :], frequencies[:, np.newaxis])
    draw_groove_map(axes, MM * strokes, frequencies, grooves)
    axes.set(xlabel="stroke S (mm)", ylabel="frequency f (Hz)")


def _cross(axes: Axes, bands: Bands, style: Mapping[str, Any]) -> None:
    axes.errorbar(
        MM * bands.speed.value,
        bands.power.value,
        xerr=_reach(bands.speed, MM),
        yerr=_reach(bands.power, 1.0),
        **{**style, "label": "_nolegend_"},
        linestyle="none",
        elinewidth=1.5,
        zorder=5,
    )


def _reach(band: Band, scale: float) -> list[list[float]]:
    below, above = band.value - band.low, band.high - band.value
    return [[scale * max(below, 0.0)], [scale * max(above, 0.0)]]


def _columns(gaits: tuple[Prediction, ...], *names: str) -> list[Array]:
    return [np.array([getattr(gait, name) for gait in gaits]) for name in names]


def _or_zero(value: float) -> float:
    return value if np.isfinite(value) else 0.0
