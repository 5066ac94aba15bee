# SPDX-License-Identifier: Apache-2.0
"""Figures of a study: results over two quantities, and neighbours of the best point."""

from __future__ import annotations

import io
import math
from dataclasses import dataclass

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure
from numpy.typing import NDArray

from worm_model.analysis.plot_style import BLUE, GREY, VERMILION, finish, new_figure
from worm_optimizer.study.summary import Column, Summary

Array = NDArray[np.float64]

_ACROSS = 3  # largest number of panels next to each other
_SHOWN = {"m": (1e3, "mm"), "m/s": (1e3, "mm/s")}  # units that are shown instead of SI units


def label(column: Column) -> str:
    """Return the name of a quantity with the unit in which it is shown."""
    unit = _SHOWN.get(column.unit, (1.0, column.unit))[1]
    name = column.name.replace("_", " ")
    return f"{name} ({unit})" if unit not in ("1", "") else name


def shown(column: Column) -> Array:
    """Return the values in the unit in which they are shown."""
    return column.values * _SHOWN.get(column.unit, (1.0, ""))[0]


@dataclass(frozen=True)
class Picture:
    """Figure as a PNG, with its caption."""

    png: bytes
    caption: str


def pictures(summary: Summary) -> list[Picture]:
    """Return the figures of a study. Their kinds depend on the number of varied quantities."""
    varied = summary.varied
    made = []
    if len(varied) >= 2:
        first, second = varied[:2]
        made.append(
            Picture(
                png(_over_two(summary, first, second)),
                f"Results over {label(first)} and {label(second)}. Where several points coincide, the best is shown: "
                f"the one with {summary.goal}. The star is the best of all points.",
            )
        )
    if summary.best is not None and varied:
        made.append(
            Picture(
                png(_neighbours(summary)),
                "The best point (star) and, on a line, the points that differ from it in one quantity alone. Panels "
                "without such points show all points in grey.",
            )
        )
    return made


def _over_two(summary: Summary, first: Column, second: Column) -> Figure:
    across = min(len(summary.figures), _ACROSS)
    down = math.ceil(len(summary.figures) / across)
    figure = new_figure(4.2 * across, 3.8 * down)
    for place, column in enumerate(summary.figures):
        axes = figure.add_subplot(down, across, place + 1)
        drawn: ScalarMappable
        x, y, z = shown(first), shown(second), shown(column)
        order = np.argsort(-summary.rank)  # of points at the same place, the best is drawn last
        if _is_grid(first, second):
            xs, ys = np.unique(x), np.unique(y)
            field = np.full((ys.size, xs.size), np.nan)
            field[np.searchsorted(ys, y[order]), np.searchsorted(xs, x[order])] = z[order]
            drawn = axes.pcolormesh(xs, ys, field, shading="nearest", cmap="viridis")
        else:
            drawn = axes.scatter(x[order], y[order], c=z[order], s=22, cmap="viridis")
        figure.colorbar(drawn, ax=axes, label=label(column))
        if summary.best is not None:
            axes.plot(
                x[summary.best],
                y[summary.best],
                "*",
                color=VERMILION,
                markersize=14,
                markeredgecolor="white",
            )
        axes.set_xlabel(label(first))
        axes.set_ylabel(label(second))
    return figure


def _is_grid(first: Column, second: Column) -> bool:
    places = np.unique(first.values).size * np.unique(second.values).size
    return places <= first.values.size


def _neighbours(summary: Summary) -> Figure:
    best = summary.best
    assert best is not None
    varied, columns = summary.varied, summary.figures
    figure = new_figure(3.0 * len(varied) + 0.6, 2.3 * len(columns))
    panels = figure.subplots(len(columns), len(varied), squeeze=False, sharex="col", sharey="row")
    for k, quantity in enumerate(varied):
        others = [other.values for j, other in enumerate(varied) if j != k]
        alike = [values == values[best] for values in others]
        rows = np.flatnonzero(np.all([np.ones(quantity.values.size, dtype=bool), *alike], axis=0))
        sampled = rows.size < 2
        if sampled:
            rows = np.arange(quantity.values.size)
        rows = rows[np.argsort(quantity.values[rows])]
        for j, column in enumerate(columns):
            axes = panels[j, k]
            style = "." if sampled else ".-"
            axes.plot(
                shown(quantity)[rows], shown(column)[rows], style, color=GREY if sampled else BLUE
            )
            axes.plot(
                shown(quantity)[best], shown(column)[best], "*", color=VERMILION, markersize=12
            )
            finish(axes, label(column) if k == 0 else "")
            if j == len(columns) - 1:
                axes.set_xlabel(label(quantity))
    return figure


def png(figure: Figure) -> bytes:
    """Return a figure as a PNG without the version of the library, so that equal figures result in equal bytes."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110, metadata={"Software": None})
    return buffer.getvalue()
