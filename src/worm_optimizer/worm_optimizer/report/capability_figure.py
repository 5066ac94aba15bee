# SPDX-License-Identifier: Apache-2.0
"""Figure of a robot's capability: lowest cost of transport and highest speed by load, and largest loads of gaits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from matplotlib.figure import Figure

from worm_model.analysis import plot_style
from worm_optimizer.search.capability import Capability, LoadPoint


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
