# SPDX-License-Identifier: Apache-2.0
"""Charts as HTML: lines as SVG that fills its place, and texts beside it that keep their size on any screen."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

_SIZE = 1000  # width and height of the drawn area in its own units

Point = tuple[float, float]


@dataclass(frozen=True)
class Axis:
    """Axis from ``low`` to ``high`` with round numbers at ``ticks``."""

    name: str
    low: float
    high: float
    ticks: tuple[float, ...]

    def place(self, value: float) -> float:
        """Return the place of a value along the axis, 0 to 1."""
        return (value - self.low) / (self.high - self.low)


def axis_of(name: str, values: Sequence[float], count: int = 4) -> Axis:
    """Return an axis over the finite values that begins and ends at one of some ``count`` round numbers."""
    finite = [value for value in values if math.isfinite(value)] or [0.0, 1.0]
    low, high = min(finite), max(finite)
    step = _round_step(max(high - low, 1e-3 * abs(high), 1e-6) / count)
    first, last = math.floor(low / step + 1e-9), math.ceil(high / step - 1e-9)
    last = max(last, first + 1)
    ticks = tuple(step * number for number in range(first, last + 1))
    return Axis(name, ticks[0], ticks[-1], ticks)


def _round_step(least: float) -> float:
    """Return the smallest of 1, 2, 5 times a power of ten that is not below ``least``."""
    power = 10.0 ** math.floor(math.log10(least))
    return next(power * digit for digit in (1.0, 2.0, 5.0, 10.0) if power * digit >= least * 0.999)


def lines(x: Axis, y: Axis, curves: Sequence[tuple[str, Sequence[Point]]]) -> str:
    """Return a chart of curves as HTML. Each curve has a CSS class and points; a point with NaN interrupts it."""
    drawn = "".join(
        f'<path class="curve {kind}" d="{_path(x, y, points)}"/>' for kind, points in curves
    )
    return _framed(x, y, drawn)


def dots(x: Axis, y: Axis, points: Sequence[Point], chosen: int | None) -> str:
    """Return a chart of points as HTML, with a mark on the one with the index ``chosen``."""
    drawn = f'<path class="dots" d="{"".join(_dot(x, y, point) for point in points)}"/>'
    if chosen is not None:
        drawn += f'<path class="dots chosen" d="{_dot(x, y, points[chosen])}"/>'
    return _framed(x, y, drawn)


def _framed(x: Axis, y: Axis, drawn: str) -> str:
    grid = "".join(f"M{_across(x, value)} 0V{_SIZE}" for value in x.ticks)
    grid += "".join(f"M0 {_down(y, value)}H{_SIZE}" for value in y.ticks)
    texts = "".join(
        f'<i class="x" style="left:{100.0 * x.place(value):.1f}%">{value:g}</i>'
        for value in x.ticks
    )
    texts += "".join(
        f'<i class="y" style="bottom:{100.0 * y.place(value):.1f}%">{value:.6g}</i>'
        for value in y.ticks
    )
    return (
        f'<div class="area"><svg viewBox="0 0 {_SIZE} {_SIZE}" preserveAspectRatio="none" aria-hidden="true">'
        f'<path class="grid" d="{grid}"/>{drawn}</svg>{texts}</div><div class="axis">{x.name}</div>'
    )


def _path(x: Axis, y: Axis, points: Sequence[Point]) -> str:
    parts, pen = [], "M"
    for across, up in points:
        if math.isfinite(up):
            parts.append(f"{pen}{_across(x, across)} {_down(y, up)}")
            pen = "L"
        else:
            pen = "M"
    return "".join(parts)


def _dot(x: Axis, y: Axis, point: Point) -> str:
    return f"M{_across(x, point[0])} {_down(y, point[1])}h0"


def _across(axis: Axis, value: float) -> int:
    return round(_SIZE * axis.place(value))


def _down(axis: Axis, value: float) -> int:
    return round(_SIZE * (1.0 - axis.place(value)))
