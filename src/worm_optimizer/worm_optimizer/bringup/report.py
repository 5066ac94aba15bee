# SPDX-License-Identifier: Apache-2.0
"""Measured against predicted: the table that the demo prints."""

from __future__ import annotations

from collections.abc import Mapping

from worm_optimizer.bringup.figures import Figures

_WIDTH = 34


def relative_difference(value: float, reference: float) -> float:
    """(value − reference) / |reference|; NaN if the reference is zero or either is NaN."""
    return (value - reference) / abs(reference) if reference else float("nan")


def comparison_table(measured: Figures, predictions: Mapping[str, Figures]) -> str:
    """One row of the measurement, and of each prediction with its relative difference to it.

    Arguments are in SI units; the table shows mm/s, W and percent.
    """
    lines = [
        f"{'':{_WIDTH}}{'speed':>18}{'power':>18}{'cost of transport':>20}",
        _row("measured on the robot", measured),
    ]
    for name, figures in predictions.items():
        lines.append(_row(name, figures, measured))
    return "\n".join(lines)


def _row(name: str, figures: Figures, reference: Figures | None = None) -> str:
    cells = (
        (f"{1e3 * figures.speed:.2f} mm/s", "speed", 18),
        (f"{figures.power:.2f} W", "power", 18),
        (f"{figures.cost_of_transport:.1f}", "cost_of_transport", 20),
    )
    text = f"{name:{_WIDTH}}"
    for cell, field, width in cells:
        if reference is not None:
            share = relative_difference(getattr(figures, field), getattr(reference, field))
            cell = f"{cell} {100.0 * share:+5.1f} %"
        text += f"{cell:>{width}}"
    return text
