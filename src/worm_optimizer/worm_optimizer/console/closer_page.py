# SPDX-License-Identifier: Apache-2.0
"""Closer look at one or two recorded runs: charts with zoom and cursor, pictures of the robot, and a time slider."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from nicegui import events, ui

from worm_model.analysis.plot_style import BLUE, GREEN, VERMILION
from worm_optimizer.console.run_traces import RunTraces

_CURSOR = "#c62828"  # colour of the line at the time of the slider
# title, factor from SI units to those of the title, and the traces with their colours
_CHARTS: tuple[tuple[str, float, dict[str, str]], ...] = (
    (
        "length, mm",
        1e3,
        {"commanded": "#888888", "cable": GREEN, "measured": BLUE, "estimated": VERMILION},
    ),
    ("power, W", 1.0, {"power": BLUE, "predicted": VERMILION}),
    ("position x1, mm", 1e3, {"x1": BLUE, "x1 of the twin": VERMILION}),
)
_HEIGHT, _GAP = 190, 70  # height of a chart and distance between two charts, px
_DASHES = ("solid", "dashed")  # styles of the lines of the first and of the second run
_SLIDER_STEP_S = 0.02
_REDRAW_S = 0.05  # shortest time between two pictures, s


class CloserLook:
    """Charts over the time since the onset, and a slider for the time at which the pictures show the robots."""

    def __init__(self, runs: Sequence[RunTraces]) -> None:
        self._runs = runs
        first = min(float(run.time_s[0]) for run in runs)
        last = max(float(run.time_s[-1]) for run in runs)
        start = min(max(first, 0.0), last)
        self._pictures = []
        for run in runs:
            ui.label(run.name)
            self._pictures.append(ui.html("", sanitize=False).classes("w-full scene"))
        with ui.row().classes("items-center w-full no-wrap gap-4"):
            self._time = ui.label().classes("line").style("min-width: 7rem")
            # The browser's own slider: screen readers and all keys operate it.
            slider = ui.element("input").classes("w-full")
            slider.props(f"type=range min={first:.2f} max={last:.2f} step={_SLIDER_STEP_S}")
            slider.props(f"value={start:.2f}")
            slider.props('aria-label="Time since the onset, s"')
            slider.on(
                "input",
                self._on_slider,
                throttle=_REDRAW_S,
                js_handler="(event) => emit(event.target.value)",
            )
        ui.label(
            "Drag in a chart to move it, turn the wheel to zoom, point at a chart to read all values at that moment. "
            f"Times are since the onset. There is one value every {1e3 * _step_s(runs):.0f} ms."
        )
        self._chart = ui.echart(_options(runs), renderer="svg").classes("w-full chart")
        self._chart.props('role=img aria-label="Length, power and position over time"')
        self._chart.style(f"height: {len(_CHARTS) * (_HEIGHT + _GAP) + 60}px")
        self._show(start)

    def _on_slider(self, event: events.GenericEventArguments) -> None:
        self._show(float(event.args))

    def _show(self, time_s: float) -> None:
        self._time.set_text(f"{time_s:.2f} s")
        for run, shown in zip(self._runs, self._pictures, strict=True):
            shown.set_content(run.picture_at(time_s))
        cursor = {"series": [{"id": f"cursor {n}", **_cursor(time_s)} for n in range(len(_CHARTS))]}
        self._chart.run_chart_method("setOption", cursor)


def _step_s(runs: Sequence[RunTraces]) -> float:
    return max(float(np.diff(run.time_s[:2]).max(initial=0.0)) for run in runs)


def _cursor(time_s: float) -> dict[str, Any]:
    return {"markLine": {"data": [{"xAxis": round(time_s, 3)}]}}


def _options(runs: Sequence[RunTraces]) -> dict[str, Any]:
    axes = range(len(_CHARTS))
    lines = {"lineStyle": {"color": "#88888855"}}
    tops = [40 + n * (_HEIGHT + _GAP) for n in axes]
    everywhere = {"xAxisIndex": list(axes)}
    return {
        "animation": False,
        "title": [
            {"text": title, "left": 0, "top": top - 24, "textStyle": {"fontSize": 13}}
            for top, (title, _, _) in zip(tops, _CHARTS, strict=True)
        ],
        "legend": {"top": 0, "left": 150, "type": "scroll"},
        "tooltip": {"trigger": "axis", "axisPointer": {"type": "line"}},
        "axisPointer": {"link": [{"xAxisIndex": "all"}]},
        "dataZoom": [
            {"type": "inside", **everywhere, "filterMode": "none"},
            {"type": "slider", **everywhere, "filterMode": "none", "bottom": 8},
        ],
        "grid": [{"left": 50, "right": 25, "top": top, "height": _HEIGHT} for top in tops],
        "xAxis": [
            {
                "type": "value",
                "gridIndex": n,
                "splitLine": lines,
                "min": "dataMin",
                "max": "dataMax",
                "name": "time, s",
                "nameLocation": "middle",
                "nameGap": 24,
            }
            for n in axes
        ],
        "yAxis": [
            {"type": "value", "scale": True, "gridIndex": n, "splitLine": lines} for n in axes
        ],
        "series": [line for n in axes for line in _lines(runs, n)]
        + [_cursor_series(n) for n in axes],
    }


def _cursor_series(axis: int) -> dict[str, Any]:
    """Return a series without points. Its mark line shows the time of the slider."""
    mark = {
        "symbol": "none",
        "silent": True,
        "label": {"show": False},
        "lineStyle": {"color": _CURSOR, "type": "solid"},
    }
    return {
        "id": f"cursor {axis}",
        "type": "line",
        "data": [],
        "xAxisIndex": axis,
        "yAxisIndex": axis,
        "markLine": {**mark, **_cursor(0.0)["markLine"]},
    }


def _lines(runs: Sequence[RunTraces], axis: int) -> list[dict[str, Any]]:
    _, scale, traces = _CHARTS[axis]
    return [
        {
            "type": "line",
            "showSymbol": False,
            "xAxisIndex": axis,
            "yAxisIndex": axis,
            "name": name if len(runs) == 1 else f"{name}, {run.name}",
            "color": colour,
            "lineStyle": {"type": dash, "width": 1.5},
            "data": _points(run.time_s, scale * run.traces[name]),
        }
        for run, dash in zip(runs, _DASHES, strict=False)
        for name, colour in traces.items()
    ]


def _points(times: Any, values: Any) -> list[list[float | None]]:
    return [
        [round(time, 3), round(value, 3) if math.isfinite(value) else None]
        for time, value in zip(times.tolist(), values.tolist(), strict=True)
    ]
