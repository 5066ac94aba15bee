# SPDX-License-Identifier: Apache-2.0
"""The cockpit: the robot in its pipe, the choice and run of a gait, and the last minute."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

from nicegui import ui

from worm_optimizer.console.charts import Axis, axis_of, lines
from worm_optimizer.console.console_state import ConsoleState
from worm_optimizer.console.gait_page import GaitPage
from worm_optimizer.console.view import HISTORY_S, margin_text, missing_sources, twin_text

FRAME_S = 1.0 / 30.0
REFRESH_S = 0.25
CHART_S = 0.5
_TIME = Axis("time, s", -HISTORY_S, 0.0, (-60.0, -45.0, -30.0, -15.0, 0.0))
# Title, factor from the SI unit, decimals, and curves of each chart: key of a sample and its name
_CHARTS = (
    (
        "length, mm",
        1e3,
        1,
        {
            "commanded": "commanded",
            "cable": "cable",
            "measured": "measured",
            "estimated": "twin",
        },
    ),
    ("power, W", 1.0, 2, {"power": "measured", "predicted": "twin"}),
)
_OF_TWIN = ("estimated", "predicted")
_LEGEND = (
    '<span><svg class="worm sample" viewBox="0 0 20 10"><{} class="{}" {}/></svg> {}</span>'.format
)


class CockpitPage:
    """View of the robot and commands to it. The picture is updated while the cockpit is shown.

    Args:
        state: shared state of the pages.
        why_not: returns the reason why this page may not command the robot; empty if it may.
        is_shown: returns True while the cockpit is shown.
    """

    def __init__(
        self, state: ConsoleState, why_not: Callable[[], str], is_shown: Callable[[], bool]
    ) -> None:
        self._state, self._is_shown = state, is_shown
        self._drawn = ""
        gait = GaitPage(state, why_not)
        with ui.element("div").classes("cockpit"):
            with ui.element("section").classes("top").props('aria-label="Robot"'):
                self._scene = ui.html("", sanitize=False).classes("scene")
                with ui.row().classes("items-center gap-x-4 gap-y-0 w-full"):
                    gait.actions()
                    self._health = ui.label().classes("line").props("role=status")
                    self._missing = ui.label().classes("line error").props("role=status")
                    ui.space()
                    ui.html(_legend(), sanitize=False).classes("legend")
            with ui.element("section").classes("choice").props('aria-label="Gait"'):
                gait.front()
            with ui.element("section").props('aria-label="Prediction and run"'):
                gait.run()
                gait.numbers()
            with ui.element("section").classes("minutes").props('aria-label="The last minute"'):
                self._margin = ui.label().classes("line").props("role=status")
                self._charts = [
                    ui.html("", sanitize=False).classes("chart minute") for _ in _CHARTS
                ]
        for period, update in (
            (FRAME_S, self._draw),
            (REFRESH_S, self._refresh),
            (CHART_S, self._plot),
        ):
            ui.timer(period, lambda update=update: update() if self._is_shown() else None)

    def _draw(self) -> None:
        drawn = self._state.picture()
        if drawn != self._drawn:
            self._drawn = drawn
            self._scene.set_content(drawn)

    def _refresh(self) -> None:
        snapshot, now = self._state.snapshot(), time.monotonic()
        self._missing.set_text("; ".join(missing_sources(snapshot, now)))
        self._health.set_text(twin_text(snapshot, now))
        self._margin.set_text(margin_text(self._state.twin()))

    def _plot(self) -> None:
        for shown, chart in zip(self._charts, _CHARTS, strict=True):
            shown.set_content(_chart(list(self._state.samples), *chart))


def _chart(
    samples: list[dict[str, float]],
    title: str,
    scale: float,
    decimals: int,
    names: dict[str, str],
) -> str:
    """Return a chart of the last minute as HTML, with the newest values in its legend.

    The time of a value of the twin is ``twin_age`` before the time of the sample.
    """
    now = time.monotonic()
    curves, values, legend = [], [], []
    for name, text in names.items():
        late = name in _OF_TWIN
        times = [s["time"] - s["twin_age"] * late - now for s in samples]
        values_of = [scale * s[name] for s in samples]
        points = [p for p in zip(times, values_of, strict=True) if p[0] >= -HISTORY_S]
        curves.append((text, points))
        values += [value for _, value in points]
        newest = points[-1][1] if points else math.nan
        shown = f"{newest:.{decimals}f}" if math.isfinite(newest) else "–"
        legend.append(_LEGEND("path", f"curve {text}", 'd="M0 5h20"', f"{text} {shown}"))
    return f'<div class="legend"><b>{title}</b> {"".join(legend)}</div>' + lines(
        _TIME, axis_of(title, values), curves
    )


def _legend() -> str:
    """Return the legend of the picture."""
    box = 'x="1" y="1" width="18" height="8" rx="2"'
    return "".join(
        (
            _LEGEND("rect", "robot module", box, "measured"),
            _LEGEND("rect", "twin module", box, "twin"),
            _LEGEND("path", "fin hold", 'd="M2 5h16"', "fin holds"),
            _LEGEND("path", "fin yield", 'd="M2 5h16"', "yields"),
            _LEGEND("path", "fin touch", 'd="M2 5h16"', "touches nothing"),
        )
    )
