# SPDX-License-Identifier: Apache-2.0
"""The tab that shows the robot: in its pipe, in numbers, and a minute back."""

from __future__ import annotations

import math
import time
from typing import Any

from nicegui import ui

from worm_model.analysis.plot_style import BLUE, GREEN, VERMILION
from worm_optimizer.console.hub import Hub
from worm_optimizer.console.page_chart import chart
from worm_optimizer.console.view import REMEMBERED_S, Sample, silences, twin_words

FRAME_S = 1.0 / 30.0
WORDS_S = 0.25
CHART_S = 0.5
_LENGTHS = {"commanded": "#888888", "cable": GREEN, "measured": BLUE, "estimated": VERMILION}
_OF_TWIN = ("estimated", "predicted")
_POWERS = {"power": BLUE, "predicted": VERMILION}
_ROWS = (
    *("commanded length", "cable length", "measured length", "estimated length"),
    *("measured power", "predicted power", "residual of x1", "residual of length"),
    *("residual of power", "groove phase", "grooves per cycle"),
)


class LivePage:
    """Draws as long as it is seen and not paused."""

    def __init__(self, hub: Hub) -> None:
        self._hub = hub
        self._drawn = ""
        with ui.column().classes("w-full gap-2"):
            self._silent = ui.label().classes("silent").props("role=status")
            self._health = ui.label().classes("text-lg")
            self._scene = ui.html("", sanitize=False).classes("w-full scene")
            with ui.row().classes("items-center w-full"):
                self._pause = ui.switch("Pause")
                ui.label("blue: robot, amber: twin; fins green hold, amber yield, grey are free")
            with ui.row().classes("w-full gap-4"):
                self._cells = _table(_ROWS)
                with ui.column().style("flex: 1 1 18rem; min-width: 0"):
                    self._lengths = _chart("length, mm", _LENGTHS)
                    self._powers = _chart("power, W", _POWERS)
        ui.timer(FRAME_S, self._draw)
        ui.timer(WORDS_S, self._tell)
        ui.timer(CHART_S, self._plot)

    def _draw(self) -> None:
        if self._pause.value:
            return
        drawn = self._hub.picture()
        if drawn != self._drawn:
            self._drawn = drawn
            self._scene.set_content(drawn)

    def _tell(self) -> None:
        if self._pause.value:
            return
        snapshot, now = self._hub.snapshot(), time.monotonic()
        self._silent.set_text("; ".join(silences(snapshot, now)))
        self._health.set_text(twin_words(snapshot, now))
        for name, text in self._hub.numbers(now).items():
            self._cells[name].set_text(text)

    def _plot(self) -> None:
        if self._pause.value:
            return
        samples = list(self._hub.history.samples)
        _fill(self._lengths, samples, _LENGTHS, 1e3)
        _fill(self._powers, samples, _POWERS, 1.0)


def _table(names: tuple[str, ...]) -> dict[str, ui.label]:
    """A cell for each name."""
    cells = {}
    with ui.grid(columns=2).classes("gap-x-4 gap-y-0 numbers"):
        for name in names:
            ui.label(name)
            cells[name] = ui.label("–").classes("value")
    return cells


def _chart(title: str, lines: dict[str, str]) -> ui.echart:
    """An empty chart of a minute."""
    series = [
        {"name": name, "type": "line", "showSymbol": False, "color": colour, "data": []}
        for name, colour in lines.items()
    ]
    return chart({"min": -REMEMBERED_S, "max": 0, "name": "time, s"}, title, series, height="14rem")


def _fill(shown: ui.echart, samples: list[Sample], lines: dict[str, str], scale: float) -> None:
    now = time.monotonic()
    for series, name in zip(shown.options["series"], lines, strict=True):
        series["data"] = [_point(sample, name, now, scale) for sample in samples]
    shown.update()


def _point(sample: Sample, name: str, now: float, scale: float) -> list[Any]:
    """Seconds ago and the value; no value where there was silence."""
    value = getattr(sample, name)
    age = sample.twin_age if name in _OF_TWIN else 0.0
    return [
        round(sample.time - age - now, 1),
        round(scale * value, 3) if math.isfinite(value) else None,
    ]
