# SPDX-License-Identifier: Apache-2.0
"""Figures of a run for the demo, reports and the identification: x1, length change, power and energy.

Callers convert a run to `Curve`s; the functions of this module arrange them in panels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MultipleLocator

from worm_model.analysis import plot_style
from worm_model.arrays import Array

WIDTH, _HEIGHT = 8.5, 1.75  # inches; width of a figure, height of a panel of weight 2
_TIME = "time since the gait's onset (s)"
_RIDGES = "horizontal lines: the pipe's ridges"
X1 = "rear module x1 (mm)"


@dataclass(frozen=True)
class Curve:
    """Time series of one source: ``time`` (n,) in s since the onset, ``values`` (n,) in SI units, NaN if unknown."""

    label: str
    time: Array
    values: Array
    style: plot_style.Style


Curves = Sequence[Curve]


@dataclass(frozen=True)
class Frame:
    """Common properties of a figure's panels: time span (s), averaged cycles (s) if any, and title."""

    start: float
    end: float
    averaged: tuple[float, float] | None = None
    title: str = ""


@dataclass(frozen=True)
class Panel:
    """One diagram of a figure.

    Attributes:
        label: label of the y axis.
        curves: the curves.
        scale: factor from SI units to the unit of the y axis.
        weight: relative height.
        pitch: distance between the horizontal lines that mark the pipe's ridges, m; None: no lines.
    """

    label: str
    curves: Curves
    scale: float = 1.0
    weight: float = 2.0
    pitch: float | None = None


def positions_panel(label: str, curves: Curves, pitch: float | None = None) -> Panel:
    """Return the panel of positions in mm, with lines at the ridges of the pipe (``pitch`` in m)."""
    return Panel(label, curves, plot_style.MM, 3.0, pitch)


def residuals_panel(curves: Curves, unit: str = "mm", scale: float = plot_style.MM) -> Panel:
    """Return the panel of residuals."""
    return Panel(f"residual ({unit})", curves, scale, 1.2)


def length_panel(curves: Curves) -> Panel:
    """Return the panel of the length change."""
    return Panel("length change ΔL (mm)", curves, plot_style.MM)


def power_panel(curves: Curves) -> Panel:
    """Return the panel of the source power."""
    return Panel("source power (W)", curves)


def motion_figure(frame: Frame, positions: Curves, residuals: Curves, pitch: float) -> Figure:
    """Return a figure of x1, with lines at the ridges of the pipe (``pitch`` in m), and of the residual of x1."""
    x1 = positions_panel(X1, positions, pitch)
    return figure_of(frame, [x1, residuals_panel(residuals)])


def length_figure(frame: Frame, lengths: Curves, inputs: Curves) -> Figure:
    """Return a figure of the length change and, below it, of the commanded and effective inputs (eq:slack_clip)."""
    return figure_of(frame, [length_panel(lengths), Panel("input (mm)", inputs, plot_style.MM)])


def energy_figure(frame: Frame, powers: Curves, energies: Curves, residuals: Curves) -> Figure:
    """Return a figure of the source power, of the energy, and of the residual of the energy."""
    energy, residual = Panel("energy (J)", energies), residuals_panel(residuals, "J", 1.0)
    return figure_of(frame, [power_panel(powers), energy, residual])


def figure_of(frame: Frame, contents: Sequence[Panel]) -> Figure:
    """Return a figure with the panels one below the other; the averaged cycles are shaded."""
    weights = [content.weight for content in contents]
    figure = plot_style.new_figure(WIDTH, 0.8 + 0.5 * _HEIGHT * sum(weights))
    if frame.title:
        figure.suptitle(frame.title, fontsize="medium")
    panels = list(
        np.atleast_1d(figure.subplots(len(contents), 1, sharex=True, height_ratios=weights))
    )
    panels[-1].set_xlabel(_TIME)
    for axes, content in zip(panels, contents, strict=True):
        _draw(axes, content, frame)
        if frame.averaged is not None and frame.averaged[0] < frame.end:
            label = "averaged cycles" if axes is panels[0] else ""
            plot_style.shade(axes, *frame.averaged, label=label)
        plot_style.finish(axes, content.label, "" if content.pitch is None else _RIDGES)
        if content.pitch is not None:
            _rule_ridges(axes, plot_style.MM * content.pitch)
    plot_style.letter(panels)
    figure.align_ylabels()
    return figure


def _draw(axes: Axes, content: Panel, frame: Frame) -> None:
    """Draw the curves within the frame, so that values outside do not affect the axes."""
    for curve in content.curves:
        inside = (curve.time >= frame.start) & (curve.time <= frame.end)
        axes.plot(
            curve.time[inside],
            content.scale * curve.values[inside],
            label=curve.label,
            **curve.style,
        )
    axes.set_xlim(frame.start, frame.end)


def _rule_ridges(axes: Axes, pitch: float) -> None:
    axes.grid(visible=False, axis="y")
    axes.yaxis.set_minor_locator(MultipleLocator(pitch))
    axes.grid(visible=True, axis="y", which="minor", linewidth=0.4)
    axes.tick_params(axis="y", which="minor", length=0)
