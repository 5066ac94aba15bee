# SPDX-License-Identifier: Apache-2.0
"""The tab Live: picture of the robot in its pipe, present values, and charts of the last minute."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from functools import partial
from typing import Any

from nicegui import ui

from worm_model.analysis.plot_style import BLUE, GREEN, VERMILION
from worm_optimizer.console.console_state import ConsoleState
from worm_optimizer.console.page_chart import chart
from worm_optimizer.console.view import HISTORY_S, Sample, missing_sources, twin_text

FRAME_S = 1.0 / 30.0
REFRESH_S = 0.25
CHART_S = 0.5
_LENGTHS = {"commanded": "#888888", "cable": GREEN, "measured": BLUE, "estimated": VERMILION}
_OF_TWIN = ("estimated", "predicted")
_POWERS = {"power": BLUE, "predicted": VERMILION}
_ROWS = (
    *("commanded length", "cable length", "measured length", "estimated length"),
    *("measured power", "predicted power", "residual of x1", "residual of length"),
    *("residual of power", "groove phase", "grooves per cycle", "measured margin"),
)


class LivePage:
    """View of the robot. It is updated while its tab is shown, unless it is paused.

    Args:
        state: shared state of the pages.
        is_shown: returns True while the tab is shown.
    """

    def __init__(self, state: ConsoleState, is_shown: Callable[[], bool]) -> None:
        self._state, self._is_shown = state, is_shown
        self._drawn = ""
        with ui.column().classes("w-full gap-2"):
            ui.html("Live", tag="h2", sanitize=False).classes("text-lg")
            self._health = ui.label().classes("line")
            self._missing = ui.label().classes("line error").props("role=status")
            self._scene = ui.html("", sanitize=False).classes("w-full scene")
            with ui.row().classes("items-center w-full"):
                self._pause = ui.switch("Pause")
                ui.label(
                    "blue: robot, amber: twin. Fins, as computed by the twin: green hold, amber yield, "
                    "grey touch nothing"
                )
            with ui.row().classes("w-full gap-4"):
                self._cells = _table(_ROWS)
                with ui.column().style("flex: 1 1 18rem; min-width: 0"):
                    self._lengths = _chart("length, mm", _LENGTHS)
                    self._powers = _chart("power, W", _POWERS)
        for period, update in (
            (FRAME_S, self._draw),
            (REFRESH_S, self._refresh),
            (CHART_S, self._plot),
        ):
            ui.timer(period, partial(self._unless_paused, update))

    def _unless_paused(self, update: Callable[[], None]) -> None:
        if self._is_shown() and not self._pause.value:
            update()

    def _draw(self) -> None:
        drawn = self._state.picture()
        if drawn != self._drawn:
            self._drawn = drawn
            self._scene.set_content(drawn)

    def _refresh(self) -> None:
        snapshot, now = self._state.snapshot(), time.monotonic()
        self._missing.set_text("; ".join(missing_sources(snapshot, now)))
        self._health.set_text(twin_text(snapshot, now))
        for name, text in self._state.numbers(now).items():
            self._cells[name].set_text(text)

    def _plot(self) -> None:
        samples = list(self._state.history.samples)
        _fill(self._lengths, samples, _LENGTHS, 1e3)
        _fill(self._powers, samples, _POWERS, 1.0)


def _table(names: tuple[str, ...]) -> dict[str, ui.label]:
    """Build a table with a row for each name, and return the cells of the values by name."""
    cells = {}
    with ui.grid(columns=2).classes("gap-x-4 gap-y-0 numbers"):
        for name in names:
            ui.label(name)
            cells[name] = ui.label("–").classes("value")
    return cells


def _chart(title: str, lines: dict[str, str]) -> ui.echart:
    """Return an empty chart of the last minute."""
    series = [
        {"name": name, "type": "line", "showSymbol": False, "color": colour, "data": []}
        for name, colour in lines.items()
    ]
    return chart({"min": -HISTORY_S, "max": 0, "name": "time, s"}, title, series, height="14rem")


def _fill(shown: ui.echart, samples: list[Sample], lines: dict[str, str], scale: float) -> None:
    now = time.monotonic()
    for series, name in zip(shown.options["series"], lines, strict=True):
        series["data"] = [_point(sample, name, now, scale) for sample in samples]
    shown.update()


def _point(sample: Sample, name: str, now: float, scale: float) -> list[Any]:
    """Return [time minus now (s), scaled value or None for NaN].

    The time of a value of the twin is ``twin_age`` before the time of the sample.
    """
    value = getattr(sample, name)
    age = sample.twin_age if name in _OF_TWIN else 0.0
    return [
        round(sample.time - age - now, 1),
        round(scale * value, 3) if math.isfinite(value) else None,
    ]
