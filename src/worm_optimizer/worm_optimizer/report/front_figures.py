# SPDX-License-Identifier: Apache-2.0
"""The robust front with the measured gaits and their cost of transport, and the price of robustness."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from worm_optimizer.report.expectation import Band, Bands
from worm_optimizer.report.front_plots import plot_front, plot_price
from worm_optimizer.report.recorded import RecordedGait
from worm_optimizer.report.style import BLACK, PURPLE, new_figure
from worm_optimizer.report.verdict import title_of
from worm_optimizer.search.margin import PriceOfRobustness
from worm_optimizer.search.served import ServedFront

# Hollow and large around small and full: what was measured most often lies within what was expected.
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


def draw_measured_front(front: ServedFront, gaits: Sequence[RecordedGait]) -> Figure:
    """The front in speed and power with what was measured (spread of the cycles) and expected (95 %)."""
    figure = new_figure(8.5, 6.0)
    axes = figure.subplots()
    plot_front(axes, front, {})
    for gait in gaits:
        _cross(axes, gait.expected.bands, _EXPECTED)
        _cross(axes, gait.measured, _MEASURED)
        axes.annotate(
            f"{title_of(gait.name)}\nCOT {gait.measured.cost_of_transport.value:.1f}",
            (1e3 * gait.measured.speed.value, gait.measured.power.value),
            textcoords="offset points",
            xytext=(16, -30),
            fontsize="small",
            bbox={"boxstyle": "round", "facecolor": "white", "edgecolor": "none", "alpha": 0.8},
        )
    fastest = max([axes.get_xlim()[1], *(1.2e3 * g.measured.speed.value for g in gaits)])
    most = max([axes.get_ylim()[1], *(1.15 * g.measured.power.value for g in gaits)])
    axes.set_xlim(0.0, fastest)
    axes.set_ylim(0.0, most)
    handles, _ = axes.get_legend_handles_labels()
    handles += [Line2D([], [], linestyle="none", **style) for style in (_EXPECTED, _MEASURED)]
    axes.legend(handles=handles, loc="upper left")
    return figure


def draw_price_of_robustness(price: PriceOfRobustness) -> Figure:
    """The lowest cost of transport over the margin, and its cliff."""
    figure = new_figure(8.0, 4.6)
    plot_price(figure.subplots(), price)
    return figure


def _cross(axes: Axes, bands: Bands, style: Mapping[str, Any]) -> None:
    axes.errorbar(
        1e3 * bands.speed.value,
        bands.power.value,
        xerr=_reach(bands.speed, 1e3),
        yerr=_reach(bands.power, 1.0),
        **{**style, "label": "_nolegend_"},
        linestyle="none",
        elinewidth=1.5,
        zorder=5,
    )


def _reach(band: Band, scale: float) -> list[list[float]]:
    below, above = band.value - band.low, band.high - band.value
    return [[scale * max(below, 0.0)], [scale * max(above, 0.0)]]
