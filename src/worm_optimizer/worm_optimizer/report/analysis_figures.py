# SPDX-License-Identifier: Apache-2.0
"""Figures of the commands `capability` and `sensitivity`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from worm_model.analysis import plot_style
from worm_optimizer.robustness.sensitivity import SYMBOLS, Sensitivity
from worm_optimizer.robustness.sobol import NO_INDICES
from worm_optimizer.search.capability import Capability, LoadPoint

SHOWN = 10  # number of parameters in the figure; it shows those with the largest total indices
TITLES = {"speed": "speed", "power": "power", "cliff_margin": "cliff of the margin"}


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


def sensitivity_figure(content: Sensitivity) -> Figure:
    """Draw first-order and total indices of each quantity, with the largest total index on top."""
    figure = plot_style.new_figure(11.0, 4.5)
    panels = figure.subplots(1, len(content.indices))
    for axes, (name, indices) in zip(panels, content.indices.items(), strict=True):
        if np.all(np.isnan(indices.total)):
            axes.text(0.5, 0.5, NO_INDICES, ha="center", transform=axes.transAxes)
            axes.set(yticks=[])
        else:
            order = np.argsort(-indices.total)[:SHOWN][::-1]
            place = np.arange(order.size)
            for values, bounds, color, height, label in (
                (indices.total, indices.total_bounds, plot_style.LIGHT_GREY, 0.8, "total"),
                (indices.first, indices.first_bounds, plot_style.BLUE, 0.4, "alone"),
            ):
                low, high = bounds
                reach = np.maximum([values - low, high - values], 0.0)[:, order]
                axes.barh(place, values[order], height, color=color, label=label, xerr=reach)
            names = [SYMBOLS[content.parameters[k]] for k in order]
            axes.set_yticks(place, names)
            axes.legend(loc="lower right", fontsize="small", frameon=False)
        axes.set_xlabel("share of the variance")
        axes.set_title(TITLES[name], loc="left", fontsize="small")
    plot_style.letter(panels)
    return figure
