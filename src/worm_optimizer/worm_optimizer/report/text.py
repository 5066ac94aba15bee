# SPDX-License-Identifier: Apache-2.0
"""Measured against expected as a table for a terminal."""

from __future__ import annotations

from collections.abc import Sequence

from worm_optimizer.report.expectation import Band
from worm_optimizer.report.recorded import RecordedGait
from worm_optimizer.report.verdict import Agreement, Order, agreements, orders, percent

_FORMATS = {
    "speed": ("speed (mm/s)", 1e3, 3),
    "power": ("power (W)", 1.0, 3),
    "cost_of_transport": ("cost of transport", 1.0, 1),
}


def describe(gaits: Sequence[RecordedGait]) -> str:
    """Each figure with its expected 95 % interval, then the orders; the groove phase that it holds for."""
    heads = ("gait", "", "measured", "expected", "95 % interval", "difference", "agrees")
    rows = [heads, *(_row(row) for gait in gaits for row in agreements(gait))]
    widths = [max(len(row[column]) for row in rows) for column in range(len(heads))]
    lines = [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in rows
    ]
    phases = {f"{1e3 * gait.expected.nominal.groove_phase:+.2f} mm": None for gait in gaits}
    lines += ["", f"expected without the margin, at a groove phase of {', '.join(phases)}"]
    lines += [_order_line(order) for order in orders(gaits)]
    lines += [f"{gait.name}: {reason}" for gait in gaits for reason in gait.missing]
    return "\n".join(lines)


def _row(row: Agreement) -> tuple[str, ...]:
    name, scale, digits = _FORMATS[row.quantity]
    verdict = {True: "yes", False: "no", None: "not measured"}[row.agrees]
    return (
        row.gait,
        name,
        f"{scale * row.measured.value:.{digits}f}",
        f"{scale * row.expected.value:.{digits}f}",
        _interval(row.expected, scale, digits),
        percent(row.difference) or "-",
        verdict,
    )


def _interval(band: Band, scale: float, digits: int) -> str:
    return f"{scale * band.low:.{digits}f} to {scale * band.high:.{digits}f}"


def _order_line(order: Order) -> str:
    name = f"order by {order.quantity.replace('_', ' ')}"
    expected = " < ".join(order.expected)
    if order.measured is None:
        return f"{name}: not told, a figure is missing (expected {expected})"
    if order.preserved:
        return f"{name}: preserved, {expected}"
    return f"{name}: not preserved; expected {expected}, measured {' < '.join(order.measured)}"
