# SPDX-License-Identifier: Apache-2.0
"""The robust front with the measured gaits and their cost of transport, and the price of robustness."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from worm_optimizer.figures import plot_front, plot_price
from worm_optimizer.margin import PriceOfRobustness
from worm_optimizer.report.expectation import Band, Bands
from worm_optimizer.report.recorded import RecordedGait
from worm_optimizer.report.style import BLACK, PURPLE, new_figure
from worm_optimizer.served import ServedFront


def draw_measured_front(front: ServedFront, gaits: Sequence[RecordedGait]) -> Figure:
    """The front in speed and power with what was measured (spread of the cycles) and expected (95 %)."""
    figure = new_figure(8.5, 6.0)
    axes = figure.subplots()
    plot_front(axes, front, {})
    for number, gait in enumerate(gaits):
        first = number == 0
        _cross(axes, gait.expected.bands, PURPLE, "s", "expected, 95 %" if first else "")
        _cross(axes, gait.measured, BLACK, "*", "measured" if first else "")
        speed, power = 1e3 * gait.measured.speed.value, gait.measured.power.value
        axes.annotate(
            f"{gait.name}\nCOT {gait.measured.cost_of_transport.value:.1f}",
            (speed, power),
            textcoords="offset points",
            xytext=(10, -26),
            fontsize="small",
            bbox={"boxstyle": "round", "facecolor": "white", "edgecolor": "none", "alpha": 0.8},
        )
    fastest = max([axes.get_xlim()[1], *(1.15e3 * g.measured.speed.value for g in gaits)])
    most = max([axes.get_ylim()[1], *(1.15 * g.measured.power.value for g in gaits)])
    axes.set_xlim(0.0, fastest)
    axes.set_ylim(0.0, most)
    axes.legend(loc="upper left")
    return figure


def draw_price_of_robustness(price: PriceOfRobustness) -> Figure:
    """The lowest cost of transport over the margin, and its cliff."""
    figure = new_figure(8.0, 4.6)
    plot_price(figure.subplots(), price)
    return figure


def _cross(axes: Axes, bands: Bands, color: str, marker: str, label: str) -> None:
    axes.errorbar(
        1e3 * bands.speed.value,
        bands.power.value,
        xerr=_reach(bands.speed, 1e3),
        yerr=_reach(bands.power, 1.0),
        color=color,
        marker=marker,
        markersize=13 if marker == "*" else 6,
        markerfacecolor=color if marker == "*" else "none",
        linestyle="none",
        capsize=4,
        zorder=5,
        label=label or "_nolegend_",
    )


def _reach(band: Band, scale: float) -> list[list[float]]:
    below, above = band.value - band.low, band.high - band.value
    return [[scale * max(below, 0.0)], [scale * max(above, 0.0)]]
