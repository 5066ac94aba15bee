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
class _Panel:
    """One diagram of a figure.

    Attributes:
        label: label of the y axis.
        curves: the curves.
        scale: factor from SI units to the unit of the y axis.
        weight: relative height.
        note: text above the axes; empty: none.
        pitch: distance between the horizontal lines that mark the pipe's ridges, m; None: no lines.
    """

    label: str
    curves: Curves
    scale: float = 1.0
    weight: float = 2.0
    note: str = ""
    pitch: float | None = None


def motion_figure(frame: Frame, positions: Curves, residuals: Curves, pitch: float) -> Figure:
    """Return a figure of x1, with lines at the ridges of the pipe (``pitch`` in m), and of the residual of x1."""
    return _figure(
        frame, [_positions(positions, pitch), _residuals(residuals, "mm", plot_style.MM)]
    )


def length_figure(frame: Frame, lengths: Curves, inputs: Curves) -> Figure:
    """Return a figure of the length change and, below it, of the commanded and effective inputs (eq:slack_clip)."""
    return _figure(
        frame,
        [
            _Panel("length change ΔL (mm)", lengths, plot_style.MM),
            _Panel("input (mm)", inputs, plot_style.MM),
        ],
    )


def energy_figure(frame: Frame, powers: Curves, energies: Curves, residuals: Curves) -> Figure:
    """Return a figure of the source power, of the energy, and of the residual of the energy."""
    return _figure(
        frame,
        [
            _Panel("source power (W)", powers),
            _Panel("energy (J)", energies),
            _residuals(residuals, "J", 1.0),
        ],
    )


def overview_figure(
    frame: Frame,
    positions: Curves,
    residuals: Curves,
    lengths: Curves,
    powers: Curves,
    pitch: float,
) -> Figure:
    """Return a figure of a run: x1, its residual, length change and source power."""
    return _figure(
        frame,
        [
            _positions(positions, pitch),
            _residuals(residuals, "mm", plot_style.MM),
            _Panel("length change ΔL (mm)", lengths, plot_style.MM),
            _Panel("source power (W)", powers),
        ],
    )


def simulation_figure(
    frame: Frame, positions: Curves, lengths: Curves, forces: Curves, powers: Curves, pitch: float
) -> Figure:
    """Return a figure of a simulated gait: modules and anchors, length, forces, power."""
    return _figure(
        frame,
        [
            _Panel(
                "advance (mm)",
                positions,
                plot_style.MM,
                3.0,
                "horizontal lines: the pipe's ridges",
                pitch,
            ),
            _Panel("length change ΔL (mm)", lengths, plot_style.MM),
            _Panel("force (N)", forces),
            _Panel("source power (W)", powers),
        ],
    )


def _positions(curves: Curves, pitch: float) -> _Panel:
    note = "horizontal lines: the pipe's ridges"
    return _Panel("rear module x1 (mm)", curves, plot_style.MM, 3.0, note, pitch)


def _residuals(curves: Curves, unit: str, scale: float) -> _Panel:
    return _Panel(f"residual ({unit})", curves, scale, 1.2)


def _figure(frame: Frame, contents: Sequence[_Panel]) -> Figure:
    weights = [content.weight for content in contents]
    figure = plot_style.new_figure(WIDTH, 0.8 + 0.5 * _HEIGHT * sum(weights))
    if frame.title:
        figure.suptitle(frame.title, fontsize="medium")
    panels = list(
        np.atleast_1d(figure.subplots(len(contents), 1, sharex=True, height_ratios=weights))
    )
    for axes, content in zip(panels, contents, strict=True):
        _draw(axes, content, frame)
    panels[-1].set_xlabel(_TIME)
    _shade_averaged(panels, frame)
    for axes, content in zip(panels, contents, strict=True):
        plot_style.finish(axes, content.label, content.note)
        if content.pitch is not None:
            _rule_ridges(axes, plot_style.MM * content.pitch)
    plot_style.letter(panels)
    figure.align_ylabels()
    return figure


def _draw(axes: Axes, content: _Panel, frame: Frame) -> None:
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


def _shade_averaged(panels: Sequence[Axes], frame: Frame) -> None:
    if frame.averaged is None or frame.averaged[0] >= frame.end:
        return
    for axes in panels:
        plot_style.shade(
            axes, *frame.averaged, label="averaged cycles" if axes is panels[0] else ""
        )


def _rule_ridges(axes: Axes, pitch: float) -> None:
    axes.grid(visible=False, axis="y")
    axes.yaxis.set_minor_locator(MultipleLocator(pitch))
    axes.grid(visible=True, axis="y", which="minor", linewidth=0.4)
    axes.tick_params(axis="y", which="minor", length=0)
