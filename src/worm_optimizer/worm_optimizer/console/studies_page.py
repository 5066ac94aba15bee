# SPDX-License-Identifier: Apache-2.0
"""The tab Studies: margin scan, computation of a front, and identification of parameters from recorded runs."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from nicegui import ui

from worm_model.analysis.plot_style import BLUE, VERMILION
from worm_model.errors import InputError
from worm_model.gait import FORWARD, REVERSE
from worm_optimizer.console.bag_library import report_of
from worm_optimizer.console.console_state import ConsoleState
from worm_optimizer.console.page_chart import chart
from worm_optimizer.console.recordings_page import report_frame
from worm_optimizer.console.studies import Studies
from worm_optimizer.console.view import MOVING
from worm_optimizer.robot_commands import FrontRequest, ScanRequest, SearchResult

REFRESH_S = 0.5
_KINDS = {
    "margin": "an enlarged threshold",
    "chance": "a probability of gaining the grooves",
    "any_phase": "gaining the grooves at every phase",
}
_WAVEFORMS = {"": "as the optimizer", "sinusoid": "the paper's", "shaped": "shaped"}
_INITIAL = "those at the start of the console"


class StudiesPage:
    """Content of the tab Studies: margin scans, computation of fronts, identification and choice of the parameters.

    Args:
        state: shared state of the pages.
        studies: background work, which all pages share.
        why_not: returns the reason why this page may not command the robot; empty if it may.
        selected: returns the names of the bags that are selected in the tab Recordings.
    """

    def __init__(
        self,
        state: ConsoleState,
        studies: Studies,
        why_not: Callable[[], str],
        selected: Callable[[], Sequence[str]],
    ) -> None:
        self._state, self._studies = state, studies
        self._why_not, self._selected = why_not, selected
        self._controlled: list[ui.button] = []
        self._scan: SearchResult | None = None
        self._identified = ""
        ui.html("Studies", tag="h2", sanitize=False).classes("text-lg")
        self._obstacle = ui.label().classes("line").props("role=status")
        with ui.row().classes("w-full gap-8"):
            with ui.column().classes("gap-2").style("flex: 1 1 18rem; min-width: 0"):
                self._searches()
            with ui.column().classes("gap-2").style("flex: 1 1 18rem; min-width: 0"):
                self._identification()
        ui.timer(REFRESH_S, self._refresh)

    def _searches(self) -> None:
        with ui.row().classes("items-center gap-4"):
            ui.html("Gaits", tag="h3", sanitize=False).classes("text-lg")
            self._direction = ui.toggle({FORWARD: "Forward", REVERSE: "Reverse"}, value=FORWARD)
        with ui.row().classes("items-center gap-2"):
            self._lowest = _millimetres("From, mm")
            self._highest = _millimetres("To, mm")
            self._step = _millimetres("Step, mm")
            self._controlled.append(ui.button("Scan margins", on_click=self._ask_scan))
        self._plot = _plot().props('role=img aria-label="Lowest cost of transport over the margin"')
        with ui.row().classes("items-center gap-2"):
            self._kind = ui.select(_KINDS, value="margin", label="Robust by").classes("w-56")
            self._margin = _millimetres("Margin, mm")
            self._margin.bind_visibility_from(self._kind, "value", value="margin")
            self._probability = ui.number("Probability", value=0.95, min=0.0, max=1.0, step=0.01)
            self._probability.classes("w-28")
            self._probability.bind_visibility_from(self._kind, "value", value="chance")
            self._waveform = ui.select(_WAVEFORMS, value="", label="Waveform").classes("w-40")
            self._controlled.append(ui.button("Compute front", on_click=self._ask_front))
        ui.label(
            "For an empty field, the optimizer uses the value of its settings. Exceptions: From is then 0 mm, and the "
            "margin is the last one of the scan before the cliff."
        )
        with ui.row().classes("items-center gap-2 w-full no-wrap"):
            self._search = ui.label().classes("line").props("role=status")

    def _identification(self) -> None:
        ui.html("Parameters", tag="h3", sanitize=False).classes("text-lg")
        self._bags = ui.label().classes("line")
        with ui.row().classes("items-center gap-2"):
            self._identify = ui.button("Identify", on_click=self._ask_identification)
            self._end = ui.button("Cancel identification", on_click=self._cancel_identification)
        self._stage = ui.label().classes("line").props("role=status")
        self._used = ui.label().classes("line")
        self._file = ui.select([_INITIAL], value=_INITIAL, label="Parameters").classes("w-full")
        with ui.row().classes("items-center gap-2"):
            ui.button("Open its report", on_click=self._report)
            self._controlled.append(ui.button("Use", on_click=self._confirm))
        self._shown = ui.element("div").classes("w-full")
        with ui.dialog() as self._dialog, ui.card():
            self._question = ui.label()
            with ui.row():
                ui.button("Yes, use them", on_click=self._set_parameters)
                ui.button("No", on_click=self._dialog.close).props("flat")

    # --- buttons ---------------------------------------------------------------------

    def _may(self) -> bool:
        if why := self._why_not():
            _warn(why)
            return False
        return True

    def _may_set_parameters(self) -> bool:
        driver = self._state.snapshot().driver
        if driver is not None and driver.state in MOVING:
            _warn("the robot moves: wait until it is at rest")
            return False
        return self._may()

    def _warn_busy(self, present: str) -> None:
        _warn(f"wait: {present}" if present else self._state.worker.hindrance)

    def _ask_scan(self) -> None:
        margins = (_metres(field, 0.0) for field in (self._lowest, self._highest, self._step))
        self._ask_search(ScanRequest(self._direction.value, *margins))

    def _ask_front(self) -> None:
        kind, nan = self._kind.value, math.nan
        request = FrontRequest(
            self._direction.value,
            kind,
            _metres(self._margin, nan) if kind == "margin" else nan,
            (self._probability.value or 0.0) if kind == "chance" else 0.0,
            self._waveform.value,
        )
        self._ask_search(request)

    def _ask_search(self, request: ScanRequest | FrontRequest) -> None:
        if self._may() and not self._studies.search(request):
            self._warn_busy(self._studies.searching)

    def _ask_identification(self) -> None:
        bags = self._selected()
        if not bags:
            _warn("select the bags in Recordings first")
        elif not self._studies.identify(bags):
            self._warn_busy(self._studies.identifying)

    def _cancel_identification(self) -> None:
        self._studies.cancel_identification()

    def _report(self) -> None:
        if self._file.value == _INITIAL:
            _warn("select a parameter file that was identified here")
            return
        self._shown.clear()
        with self._shown:
            report_frame(report_of(self._file.value))

    def _confirm(self) -> None:
        if not self._may_set_parameters():
            return
        self._question.set_text(
            f"Set the parameters of twin and optimizer to {self._file.value}? They use them immediately. "
            "The driver does not change. After a restart, each node reads the file of its own configuration again; "
            "./worm start --parameters FILE sets one file for all nodes."
        )
        self._dialog.open()

    def _set_parameters(self) -> None:
        self._dialog.close()
        name = self._file.value
        try:
            is_identified = name != _INITIAL
            library, initial = self._state.library, self._studies.initial_file
            file = library.parameter_file(name) if is_identified else initial
            if self._may_set_parameters() and not self._studies.set_parameter_file(file):
                self._warn_busy("")
        except InputError as error:
            _warn(str(error))

    # --- what is shown -----------------------------------------------------------------------

    def _refresh(self) -> None:
        studies, state = self._studies, self._state
        why = self._why_not()
        self._obstacle.set_text(f"Searches and parameters: {why}" if why else "")
        for button in self._controlled:
            button.set_enabled(not why)
        searching, identifying = studies.searching, studies.identifying
        self._search.set_text(searching)
        bags = ", ".join(self._selected())
        self._bags.set_text(
            f"From {bags}" if bags else "From the bags that are selected in Recordings: none so far"
        )
        self._identify.set_enabled(not identifying)
        self._end.set_enabled(bool(identifying))
        self._stage.set_text(identifying)
        used = state.parameter_file
        self._used.set_text(f"In use: {used.rsplit('/', 1)[-1] if used else 'the paper’s values'}")
        names = [_INITIAL, *state.library.identified()]
        if names != self._file.options:
            self._file.set_options(names)
        if studies.identified != self._identified:
            self._identified = studies.identified
            self._file.set_value(self._identified)
        if studies.scan is not self._scan and studies.scan is not None:
            self._scan = studies.scan
            self._plot.set_visibility(True)
            _fill(self._plot, self._scan)


def _warn(text: str) -> None:
    ui.notify(text, type="warning")


def _millimetres(name: str) -> ui.number:
    return ui.number(name, min=0.0).classes("w-24")


def _metres(field: ui.number, empty: float) -> float:
    return empty if field.value is None else 1e-3 * float(field.value)


def _plot() -> ui.echart:
    line = {"type": "line", "symbolSize": 5, "color": BLUE, "data": []}
    cliff = {"symbol": "none", "silent": True, "data": []}
    plot = chart({"name": "margin, mm"}, "lowest cost of transport", [{**line, "markLine": cliff}])
    plot.set_visibility(False)
    return plot


def _fill(plot: ui.echart, scan: SearchResult) -> None:
    series = plot.options["series"][0]
    series["data"] = [
        [round(1e3 * margin, 3), round(cost, 3) if math.isfinite(cost) else None]
        for margin, cost in zip(scan.margins, scan.costs, strict=True)
    ]
    cliff = 1e3 * scan.cliff
    series["markLine"]["data"] = (
        [
            {
                "xAxis": cliff,
                "label": {"formatter": f"cliff {cliff:.2f}"},
                "lineStyle": {"color": VERMILION},
            }
        ]
        if math.isfinite(cliff)
        else []
    )
    plot.update()
