# SPDX-License-Identifier: Apache-2.0
"""Figures of the optimizer's results: fronts with gaits, price of robustness and capability."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from worm_model.analysis import plot_style
from worm_optimizer.evaluation.task import Array
from worm_optimizer.gait_prediction import Prediction
from worm_optimizer.report.agreement import title_of
from worm_optimizer.report.expectation import Band, Bands
from worm_optimizer.report.recorded_gait import RecordedGait
from worm_optimizer.search.capability import Capability, LoadPoint
from worm_optimizer.search.front import RobustFront
from worm_optimizer.search.price_of_robustness import PriceOfRobustness

_COSTS = (25, 50, 100, 200)  # costs of transport for which `_cost_lines` draws a line

# The measured value usually lies within the expected interval. Its small filled marker is therefore visible inside the
# large hollow marker of the expected value.
_EXPECTED: Mapping[str, Any] = {
    "color": plot_style.PURPLE,
    "marker": "s",
    "markersize": 13,
    "markerfacecolor": "none",
    "markeredgewidth": 1.5,
    "label": "expected (95 %)",
}
_MEASURED: Mapping[str, Any] = {
    "color": plot_style.BLACK,
    "marker": "*",
    "markersize": 8,
    "label": "measured (span of cycles)",
}


def front_figure(front: RobustFront, marks: Mapping[str, Prediction]) -> Figure:
    """Draw a front, with marks at some gaits and their costs of transport."""
    figure = plot_style.new_figure(6.5, 5.0)
    axes = figure.subplots()
    _plot_front(axes, front)
    _mark(axes, marks)
    plot_style.legend_above(axes, 2)
    return figure


def measured_front_figure(front: RobustFront, gaits: Sequence[RecordedGait]) -> Figure:
    """Draw a front with recorded gaits: their expected values with 95 % intervals, and their measured values.

    The bars of a measured value end at the lowest and at the highest cycle.
    """
    figure = plot_style.new_figure(8.5, 6.2)
    axes = figure.subplots()
    _plot_front(axes, front)
    for gait in gaits:
        _cross(axes, gait.expected.bands, _EXPECTED)
        _cross(axes, gait.measured, _MEASURED)
    axes.autoscale()
    axes.set(xlim=(0.0, None), ylim=(0.0, None))
    for gait in gaits:
        _name(
            axes,
            f"{title_of(gait.name)}, COT {gait.measured.cost_of_transport.value:.1f}",
            (plot_style.MM * gait.measured.speed.value, gait.measured.power.value),
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
    """Draw the lowest cost of transport as a function of the margin, coloured by branch.

    Vertical lines show the cliff of the scan, and the cliff according to the closed form.
    """
    figure = plot_style.new_figure(7.5, 4.8)
    axes = figure.subplots()
    margins = plot_style.MM * np.array([point.margin for point in price.points])
    costs = np.array([point.cost_of_transport for point in price.points])
    branches = np.array([point.branch for point in price.points])
    axes.plot(margins, costs, color=plot_style.LIGHT_GREY, linewidth=1.0)
    for branch in np.unique(branches[branches > 0])[::-1]:
        rows = branches == branch
        axes.plot(margins[rows], costs[rows], **plot_style.branch_style(int(branch)))
    if price.cliff is not None:
        cliff = plot_style.MM * price.cliff.margin
        axes.axvline(cliff, color=plot_style.BLACK, label=f"cliff: {cliff:.2f} mm")
    closed_form = plot_style.MM * price.closed_form_cliff_margin
    axes.axvline(
        closed_form,
        color=plot_style.BLACK,
        linestyle=":",
        label=f"closed form: {closed_form:.2f} mm",
    )
    axes.set(
        xlabel=f"robustness margin {plot_style.MARGIN_SYMBOL} (mm)",
        ylabel="lowest cost of transport (1)",
        ylim=(0.0, None),
    )
    axes.set_title(
        f"φ = {plot_style.MM * price.groove_phase:+.2f} mm", loc="left", fontsize="small"
    )
    plot_style.legend_above(axes, 2)
    return figure


def _plot_front(axes: Axes, front: RobustFront) -> None:
    """Draw power as a function of speed along a front, coloured by branch, with lines of equal cost of transport."""
    speed, power, grooves, cost = _columns(
        front.gaits, "speed", "power", "grooves_per_cycle", "cost_of_transport"
    )
    for branch in np.unique(np.round(grooves).astype(int)):
        rows = np.round(grooves) == branch
        axes.plot(plot_style.MM * speed[rows], power[rows], **plot_style.branch_style(int(branch)))
    axes.set_xlim(0.0, 1.12 * plot_style.MM * speed.max())
    axes.set_ylim(0.0, 1.2 * power.max())
    _cost_lines(axes, power[0] / (cost[0] * speed[0]))
    axes.set(xlabel="mean speed along the gait's direction (mm/s)", ylabel="mean source power (W)")
    margin, phase = plot_style.MM * front.margin, plot_style.MM * front.gaits[0].groove_phase
    axes.set_title(
        f"{plot_style.MARGIN_SYMBOL} = {margin:.2f} mm, φ = {phase:+.2f} mm",
        loc="left",
        fontsize="small",
    )


def _mark(axes: Axes, marks: Mapping[str, Prediction]) -> None:
    for name, gait in marks.items():
        axes.plot(
            plot_style.MM * gait.speed, gait.power, "*", color=plot_style.BLACK, markersize=13
        )
        text = f"{name.replace('_', ' ')}, COT {gait.cost_of_transport:.1f}"
        _name(axes, text, (plot_style.MM * gait.speed, gait.power))


def _name(axes: Axes, text: str, point: tuple[float, float]) -> None:
    """Write a label to the lower right of a point or, near the right end of the axes, to its upper left.

    The front does not pass through these regions.
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
        arrowprops={"arrowstyle": "-", "color": plot_style.BLACK, "linewidth": 0.6},
        zorder=4,
    )


def _cost_lines(axes: Axes, weight: float) -> None:
    """Draw lines of equal cost of transport, P = COT · m·g · v, each with a label below its end.

    ``weight`` is m·g, N.
    """
    fastest, most = axes.get_xlim()[1], axes.get_ylim()[1]
    for cost in _COSTS:
        slope = cost * weight / plot_style.MM  # W per mm/s
        end = min(fastest, most / slope)
        axes.plot(
            [0.0, end], [0.0, slope * end], color=plot_style.LIGHT_GREY, linewidth=0.8, zorder=0
        )
        axes.annotate(
            f"COT {cost}",
            (end, slope * end),
            textcoords="offset points",
            xytext=(-2, -12),
            ha="right" if slope * end < most else "left",
            color="0.4",
            fontsize=8,
        )


def _cross(axes: Axes, bands: Bands, style: Mapping[str, Any]) -> None:
    axes.errorbar(
        plot_style.MM * bands.speed.value,
        bands.power.value,
        xerr=_reach(bands.speed, plot_style.MM),
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


def capability_figure(found: Mapping[str, Capability], points: Sequence[LoadPoint]) -> Figure:
    """Draw lowest cost of transport and highest speed as functions of the load, and the largest load of each gait."""
    figure = plot_style.new_figure(11.0, 4.2)
    curves, bars = figure.subplots(1, 2, width_ratios=(1.4, 1.0))
    loads = [point.load for point in points]
    costs = [point.cost_of_transport for point in points]
    curves.plot(loads, costs, color=plot_style.BLUE, marker="o", label="lowest cost of transport")
    curves.set_xlabel("load against the gait (N)")
    speeds = curves.twinx()
    speeds.plot(
        loads,
        [plot_style.MM * point.speed for point in points],
        color=plot_style.VERMILION,
        marker="s",
        linestyle="--",
        label="highest speed",
    )
    speeds.set_ylabel("highest speed (mm/s)", color=plot_style.VERMILION)
    speeds.set_ylim(bottom=0.0)
    plot_style.finish(curves, "lowest cost of transport (1)", "best gaits without a margin")
    names = [name.replace("_", " ") for name in found]
    places = range(len(names))
    bars.barh(
        places,
        [each.largest_load for each in found.values()],
        color=[plot_style.CYCLE[place % len(plot_style.CYCLE)] for place in places],
    )
    for place, each in zip(places, found.values(), strict=True):
        note = f" {each.largest_load:.1f} N, {each.largest_slope_deg:.0f}°"
        bars.text(each.largest_load, place, note, va="center", fontsize="small")
    bars.set_yticks(places, names)
    bars.invert_yaxis()
    bars.set_xlabel("largest load (N)")
    bars.set_xlim(right=1.35 * max(each.largest_load for each in found.values()) + 1.0)
    bars.set_title("largest load and slope", loc="left", fontsize="small")
    plot_style.letter((curves, bars))
    return figure
