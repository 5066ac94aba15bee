# SPDX-License-Identifier: Apache-2.0
"""Figures of fronts, maps and margin scans; the format follows the file's name."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from worm_optimizer.robustness.prediction import Prediction
from worm_optimizer.search.margin import PriceOfRobustness
from worm_optimizer.search.served import ServedFront
from worm_optimizer.search.task import Array, MarginTask

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Okabe and Ito's palette, which colour-blind readers can tell apart; one shape a branch besides.
_BRANCH_COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00")
_BRANCH_MARKERS = ("o", "s", "^", "D", "v", "P")
_LABELS = {"min_power": "min power", "cruise": "cruise", "max_speed": "max speed"}
_MAP_STROKES, _MAP_FREQUENCIES = 241, 161


def draw_front(front: ServedFront, marks: Mapping[str, Prediction], path: Path) -> None:
    """Draws a front with marked gaits and their cost of transport."""
    plt = _pyplot()
    figure, axes = plt.subplots(figsize=(6.5, 4.8), layout="constrained")
    plot_front(axes, front, marks)
    figure.savefig(path, dpi=150)
    plt.close(figure)


def draw_front_and_map(
    front: ServedFront, task: MarginTask, marks: Mapping[str, Prediction], path: Path
) -> None:
    """Draws a front beside the map of the grooves per cycle that its gaits lie in, at the task's margin."""
    plt = _pyplot()
    figure, (left, right) = plt.subplots(1, 2, figsize=(12.5, 4.8), layout="constrained")
    plot_front(left, front, marks)
    _map(right, task)
    strokes, frequencies = _columns(front.predictions, "stroke", "frequency")
    right.plot(
        1e3 * strokes, frequencies, ".", color="white", markeredgecolor="black", label="front"
    )
    for gait in marks.values():
        right.plot(
            1e3 * gait.stroke,
            gait.frequency,
            "*",
            color="white",
            markeredgecolor="black",
            markersize=15,
        )
    right.set_title(f"Grooves per cycle at a margin of {1e3 * task.margin:.2f} mm")
    right.legend(loc="upper left", framealpha=0.9)
    figure.savefig(path, dpi=150)
    plt.close(figure)


def draw_price(price: PriceOfRobustness, path: Path) -> None:
    """Draws the lowest cost of transport over the margin, with the cliff and the closed form's."""
    plt = _pyplot()
    figure, axes = plt.subplots(figsize=(6.8, 4.5), layout="constrained")
    plot_price(axes, price)
    figure.savefig(path, dpi=150)
    plt.close(figure)


def plot_price(axes: Axes, price: PriceOfRobustness) -> None:
    """The lowest cost of transport over the margin, by branches, with the cliff and the closed form's."""
    margins = 1e3 * np.array([point.margin for point in price.points])
    costs = np.array([point.cost_of_transport for point in price.points])
    branches = np.array([point.branch for point in price.points])
    axes.plot(margins, costs, color="0.75", linewidth=1.0)
    for branch in np.unique(branches[branches > 0])[::-1]:
        rows = branches == branch
        axes.plot(margins[rows], costs[rows], linestyle="none", **_branch_style(int(branch), 4.5))
    if price.cliff is not None:
        axes.axvline(
            1e3 * price.cliff.margin,
            color="black",
            label=f"cliff: {1e3 * price.cliff.margin:.2f} mm",
        )
    closed_form = 1e3 * price.closed_form_cliff_margin
    axes.axvline(
        closed_form, color="black", linestyle=":", label=f"closed form: {closed_form:.2f} mm"
    )
    axes.set(
        xlabel="robustness margin δ_m (mm)",
        ylabel="lowest cost of transport (1)",
        title=f"Price of robustness at a groove phase of {1e3 * price.groove_phase:+.2f} mm",
        ylim=(0.0, None),
    )
    axes.legend(loc="lower right")


def _pyplot() -> Any:
    # Imported where it is needed: it would double the start-up time of all that draws nothing.
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    return plt


def _columns(gaits: tuple[Prediction, ...], *names: str) -> list[Array]:
    return [np.array([getattr(gait, name) for gait in gaits]) for name in names]


def _branch_style(branch: int, size: float) -> dict[str, Any]:
    kind = (branch - 1) % len(_BRANCH_COLORS)
    return {
        "marker": _BRANCH_MARKERS[kind],
        "color": _BRANCH_COLORS[kind],
        "markersize": size,
        "label": f"{branch} groove{'s' if branch > 1 else ''} per cycle",
    }


def plot_front(axes: Axes, front: ServedFront, marks: Mapping[str, Prediction]) -> None:
    """A front in speed and power, by branches, with lines of equal cost of transport and marked gaits."""
    speed, power, grooves, cost = _columns(
        front.predictions, "speed", "power", "grooves_per_cycle", "cost_of_transport"
    )
    for branch in np.unique(np.round(grooves).astype(int)):
        rows = np.round(grooves) == branch
        axes.plot(
            1e3 * speed[rows], power[rows], linestyle="none", **_branch_style(int(branch), 4.5)
        )
    axes.set_xlim(0.0, 1.12e3 * speed.max())
    axes.set_ylim(0.0, 1.2 * power.max())
    weight = power[0] / (cost[0] * speed[0])
    _cost_lines(axes, weight)
    for name, gait in marks.items():
        axes.plot(1e3 * gait.speed, gait.power, "*", color="black", markersize=13)
        offset, side = _label_place(gait.speed / speed.max())
        axes.annotate(
            f"{_LABELS.get(name, name)}\nCOT {gait.cost_of_transport:.1f}",
            (1e3 * gait.speed, gait.power),
            textcoords="offset points",
            xytext=offset,
            ha=side,
        )
    axes.set(
        xlabel="mean speed along the gait's direction (mm/s)",
        ylabel="mean source power (W)",
        title=f"Robust front, margin {1e3 * front.margin:.2f} mm, "
        f"groove phase {1e3 * front.predictions[0].groove_phase:+.2f} mm",
    )
    axes.legend(loc="upper left")


def _label_place(part: float) -> tuple[tuple[float, float], str]:
    """Offset in points and alignment of a label where a rising front leaves room, by part of its speeds."""
    if part > 0.8:
        return (-8.0, 10.0), "right"
    return ((8.0, -30.0) if part > 0.25 else (-10.0, 26.0)), "left"


def _cost_lines(axes: Axes, weight: float) -> None:
    """Lines of equal cost of transport, P = COT · m·g · v, labelled below where they leave the axes."""
    fastest, most = axes.get_xlim()[1], axes.get_ylim()[1]
    for cost in (25, 50, 100, 200):
        slope = cost * weight * 1e-3  # W per mm/s
        end = min(fastest, most / slope)
        axes.plot([0.0, end], [0.0, slope * end], color="0.85", linewidth=0.8, zorder=0)
        axes.annotate(
            f"COT {cost}",
            (end, slope * end),
            textcoords="offset points",
            xytext=(-2, -12),
            ha="right" if slope * end < most else "left",
            color="0.5",
            fontsize=8,
        )


def _map(axes: Axes, task: MarginTask) -> None:
    from matplotlib.colors import BoundaryNorm
    from matplotlib.pyplot import get_cmap

    box = task.bounds
    strokes = np.linspace(box.stroke_low, box.stroke_high, _MAP_STROKES)
    frequencies = np.linspace(box.frequency_low, box.frequency_high, _MAP_FREQUENCIES)
    grooves = task.grooves(strokes[np.newaxis, :], frequencies[:, np.newaxis])
    count = max(int(grooves.max()), 1) + 1
    image = axes.pcolormesh(
        1e3 * strokes,
        frequencies,
        grooves,
        cmap=get_cmap("cividis", count),
        norm=BoundaryNorm(np.arange(-0.5, count), count),
        shading="nearest",
        rasterized=True,
    )
    axes.figure.colorbar(image, ax=axes, ticks=np.arange(count), label="grooves per cycle")
    axes.set(xlabel="stroke S (mm)", ylabel="frequency f (Hz)")
