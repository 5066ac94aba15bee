# SPDX-License-Identifier: Apache-2.0
"""Charts of the pages, which are legible in light and dark appearance."""

from __future__ import annotations

from typing import Any

from nicegui import ui

# The text of a chart has the text colour of the page; the grid is visible on white and on black.
STYLE = ".chart svg text { fill: currentColor; stroke: none }"
_LINES = {"lineStyle": {"color": "#88888855"}}


def chart(
    x: dict[str, Any], y: str, series: list[dict[str, Any]], *, height: str = "15rem", **events: Any
) -> ui.echart:
    """Return a chart with a legend of its named series.

    Args:
        x: options of the horizontal axis.
        y: name of the vertical axis, which is written above the axis.
        series: the series.
        height: height in CSS units.
        events: event handlers of `ui.echart`.
    """
    legend = any("name" in row for row in series)
    options = {
        "animation": False,
        "title": {
            "text": y,
            "left": 0,
            "top": 2,
            "padding": 0,
            "textStyle": {"fontSize": 13, "fontWeight": "normal"},
        },
        "legend": {
            "show": legend,
            "left": 0,
            "top": 22,
            "padding": 0,
            "itemWidth": 16,
            "itemHeight": 8,
        },
        "grid": {"left": 45, "right": 25, "top": 50 if legend else 32, "bottom": 42},
        "xAxis": {
            "type": "value",
            "nameLocation": "middle",
            "nameGap": 26,
            "splitLine": _LINES,
            **x,
        },
        "yAxis": {"type": "value", "scale": True, "splitLine": _LINES},
        "series": series,
    }
    made = ui.echart(options, renderer="svg", **events)
    return made.classes("w-full chart").style(f"height: {height}")
