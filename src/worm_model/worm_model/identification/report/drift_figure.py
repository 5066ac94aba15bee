# SPDX-License-Identifier: Apache-2.0
"""Figure with one control chart per parameter and one point per bag."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from worm_model.analysis import plot_style
from worm_model.identification.drift import LABELS, Chart, Rule, State

MOST_LABELS = 16  # largest number of bag names along the axis
SCALES = {"m": (1e3, "mm")}  # displayed factor and unit by unit


def draw_health(names: Sequence[str], charts: Sequence[Chart], path: Path) -> None:
    """Write the figure in the format of the file extension.

    ``names`` are the names of the bags, in the order of the values in each chart.
    """
    width = min(max(7.5, 2.5 + 0.55 * len(names)), 16.0)
    figure = plot_style.new_figure(width, 1.9 * len(charts) + 1.2)
    rows = figure.subplots(len(charts), 1, sharex=True)
    for axes, chart in zip(np.atleast_1d(rows), charts, strict=True):
        _draw(axes, chart, names)
    every = -(-len(names) // MOST_LABELS)
    last = np.atleast_1d(rows)[-1]
    ticks = list(range(0, len(names), every))
    last.set_xticks(ticks, [names[k] for k in ticks], rotation=40, ha="right", fontsize=8)
    last.set_xlim(-0.5, len(names) - 0.5)
    last.set_xlabel(
        "bag, in the order of time; bars: 95 % interval of each\n"
        "squares: beyond a control limit; diamonds: part of a trend"
    )
    plot_style.save_figure(figure, path)


def _draw(axes: Axes, chart: Chart, names: Sequence[str]) -> None:
    unit, label = LABELS[chart.key]
    scale, unit = SCALES.get(unit, (1.0, unit))
    bag = np.arange(chart.value.size)
    _draw_limits(axes, chart, scale)
    bars = scale * np.abs(np.vstack([chart.value - chart.low, chart.high - chart.value]))
    bars[~np.isfinite(bars)] = 0.0  # an open interval has no error bar
    axes.errorbar(
        bag,
        scale * chart.value,
        bars,
        fmt="o-",
        color=plot_style.BLUE,
        ecolor=plot_style.SKY,
        ms=5,
        lw=1.2,
        zorder=3,
    )
    for signal in chart.signals:
        kept = slice(signal.first, signal.last + 1)
        marker = "s" if signal.rule is Rule.LIMIT else "D"
        axes.plot(
            bag[kept],
            scale * chart.value[kept],
            marker,
            ms=9,
            mfc="none",
            mec=plot_style.VERMILION,
            mew=1.6,
            zorder=4,
        )
    axes.set_ylabel(plot_style.symbol(label) + (f" ({unit})" if unit != "1" else ""))
    axes.margins(y=0.15)
    title = f"{chart.key}: {chart.state.value}"
    if chart.began is not None:
        title += f" since {names[chart.began]}"
    trouble = chart.state in (State.OUT, State.TRENDING)
    axes.set_title(
        title, loc="left", fontsize=10, color=plot_style.VERMILION if trouble else "black"
    )


def _draw_limits(axes: Axes, chart: Chart, scale: float) -> None:
    limits = chart.limits
    if limits is None:
        return
    for value, style, text in (
        (limits.high, "--", "upper limit"),
        (limits.centre, "-", "centre"),
        (limits.low, "--", "lower limit"),
    ):
        axes.axhline(scale * value, color=plot_style.GREY, linestyle=style, linewidth=1.0)
        axes.annotate(
            text,
            (1.0, scale * value),
            xycoords=("axes fraction", "data"),
            textcoords="offset points",
            xytext=(4, 0),
            va="center",
            fontsize=8,
            color=plot_style.GREY,
        )
    if limits.middle_high > limits.middle_low:
        axes.axhspan(scale * limits.middle_low, scale * limits.middle_high, color="0.9", zorder=0)
