# SPDX-License-Identifier: Apache-2.0
"""Measured against predicted: the table that the demo prints."""

from __future__ import annotations

from collections.abc import Mapping

from worm_model.analysis.run_metrics import Performance

_NAME_WIDTH = 34
_COLUMNS = (
    ("speed", "speed", 12),
    ("power", "power", 9),
    ("cost_of_transport", "cost of transport", 18),
)
_SHARE_WIDTH = 9  # of a relative difference after its value


def relative_difference(value: float, reference: float) -> float:
    """(value − reference) / |reference|; NaN if the reference is zero or either is NaN."""
    return (value - reference) / abs(reference) if reference else float("nan")


def comparison_table(measured: Performance, predictions: Mapping[str, Performance]) -> str:
    """One row of the measurement, and of each prediction with its relative difference to it.

    Arguments are in SI units; the table shows mm/s, W and percent.
    """
    heads = "".join(f"{head:>{width}}{'':{_SHARE_WIDTH}}" for _, head, width in _COLUMNS)
    lines = [f"{'':{_NAME_WIDTH}}{heads}".rstrip(), _row("measured on the robot", measured)]
    lines += [_row(name, figures, measured) for name, figures in predictions.items()]
    return "\n".join(lines)


def _row(name: str, figures: Performance, reference: Performance | None = None) -> str:
    cells = {
        "speed": f"{1e3 * figures.speed:.2f} mm/s",
        "power": f"{figures.power:.2f} W",
        "cost_of_transport": f"{figures.cost_of_transport:.1f}",
    }
    text = f"{name:{_NAME_WIDTH}}"
    for field, _, width in _COLUMNS:
        share = ""
        if reference is not None:
            value = relative_difference(getattr(figures, field), getattr(reference, field))
            share = f"{100.0 * value:+.1f} %"
        text += f"{cells[field]:>{width}}{share:>{_SHARE_WIDTH}}"
    return text.rstrip()
