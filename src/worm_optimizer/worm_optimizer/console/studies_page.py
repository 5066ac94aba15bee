# SPDX-License-Identifier: Apache-2.0
"""The tab of what takes minutes: margin scan, a new front, and parameters from recorded runs."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from nicegui import ui

from worm_model.analysis.plot_style import BLUE, VERMILION
from worm_model.errors import InputError
from worm_model.gait import FORWARD, REVERSE
from worm_optimizer.console.hub import Hub
from worm_optimizer.console.page_chart import chart
from worm_optimizer.console.recordings_page import report_frame
from worm_optimizer.console.shelf import report_of
from worm_optimizer.console.studies import Studies
from worm_optimizer.console.view import MOVING
from worm_optimizer.orders import FrontOrder, ScanOrder, SearchResult

WORDS_S = 0.5
_KINDS = {
    "margin": "an enlarged threshold",
    "chance": "a probability of the grooves",
    "any_phase": "the grooves at every phase",
}
_STARTED = "those that the console was started with"


class StudiesPage:
    """``forbidden`` says why this page may move nothing, empty: it may; ``chosen`` tells the bags of Recordings."""

    def __init__(
        self,
        hub: Hub,
        studies: Studies,
        forbidden: Callable[[], str],
        chosen: Callable[[], Sequence[str]],
    ) -> None:
        self._hub, self._studies, self._forbidden, self._chosen = hub, studies, forbidden, chosen
        self._scan: SearchResult | None = None
        self._identified = ""
        with ui.row().classes("w-full gap-8"):
            with ui.column().classes("gap-2").style("flex: 1 1 18rem; min-width: 0"):
                self._searches()
            with ui.column().classes("gap-2").style("flex: 1 1 18rem; min-width: 0"):
                self._identification()
        ui.timer(WORDS_S, self._tell)

    def _searches(self) -> None:
        with ui.row().classes("items-center gap-4"):
            ui.label("Gaits").classes("text-lg")
            self._direction = ui.toggle({FORWARD: "Forward", REVERSE: "Reverse"}, value=FORWARD)
        with ui.row().classes("items-center gap-2"):
            self._lowest = _millimetres("From, mm")
            self._highest = _millimetres("To, mm")
            self._step = _millimetres("Step, mm")
            ui.button("Scan margins", on_click=self._ask_scan)
        self._plot = _plot()
        with ui.row().classes("items-center gap-2"):
            self._kind = ui.select(_KINDS, value="margin", label="Robust by").classes("w-56")
            self._margin = _millimetres("Margin, mm")
            self._margin.bind_visibility_from(self._kind, "value", value="margin")
            self._probability = ui.number("Probability", value=0.95, min=0.0, max=1.0, step=0.01)
            self._probability.classes("w-28")
            self._probability.bind_visibility_from(self._kind, "value", value="chance")
            ui.button("Compute front", on_click=self._ask_front)
        ui.label(
            "What is left empty is the optimizer's own; the margin is then chosen at the cliff."
        )
        with ui.row().classes("items-center gap-2 w-full no-wrap"):
            self._how_far = ui.label().props("role=status")

    def _identification(self) -> None:
        ui.label("Parameters").classes("text-lg")
        self._bags = ui.label()
        with ui.row().classes("items-center gap-2"):
            self._identify = ui.button("Identify", on_click=self._ask_identification)
            self._end = ui.button("Cancel identification", on_click=self._cancel_identification)
        self._stage = ui.label().props("role=status")
        self._used = ui.label()
        self._file = ui.select([_STARTED], value=_STARTED, label="Parameters").classes("w-full")
        with ui.row().classes("items-center gap-2"):
            ui.button("Open its report", on_click=self._report)
            ui.button("Take over", on_click=self._confirm)
        self._shown = ui.element("div").classes("w-full")
        with ui.dialog() as self._dialog, ui.card():
            self._question = ui.label()
            with ui.row():
                ui.button("Yes, take over", on_click=self._take_over)
                ui.button("No", on_click=self._dialog.close).props("flat")

    # --- what is pressed ---------------------------------------------------------------------

    def _may(self) -> bool:
        why = self._forbidden()
        if why:
            _warn(why)
        return not why

    def _may_take(self) -> bool:
        driver = self._hub.snapshot().driver
        moves = driver is not None and driver.state in MOVING
        if moves:
            _warn("the robot moves: wait until it is at rest")
        return not moves and self._may()

    def _begun(self, begun: bool, goes_on: str) -> None:  # noqa: FBT001 (an answer)
        if not begun:
            _warn(f"wait: {goes_on}" if goes_on else self._hub.worker.hindrance)

    def _ask_scan(self) -> None:
        margins = (_metres(field, 0.0) for field in (self._lowest, self._highest, self._step))
        self._ask_search(ScanOrder(self._direction.value, *margins))

    def _ask_front(self) -> None:
        kind, nan = self._kind.value, math.nan
        order = FrontOrder(
            self._direction.value,
            kind,
            _metres(self._margin, nan) if kind == "margin" else nan,
            (self._probability.value or 0.0) if kind == "chance" else 0.0,
        )
        self._ask_search(order)

    def _ask_search(self, order: ScanOrder | FrontOrder) -> None:
        if self._may():
            self._begun(self._studies.search(order), self._studies.searching)

    def _ask_identification(self) -> None:
        bags = self._chosen()
        if not self._may():
            return
        if not bags:
            _warn("choose the bags in Recordings first")
            return
        self._begun(self._studies.identify(bags), self._studies.identifying)

    def _cancel_identification(self) -> None:
        if self._may():
            self._studies.cancel_identification()

    def _report(self) -> None:
        if self._file.value == _STARTED:
            _warn("choose a parameter file that was identified here")
            return
        self._shown.clear()
        with self._shown:
            report_frame(report_of(self._file.value))

    def _confirm(self) -> None:
        if not self._may_take():
            return
        self._question.set_text(
            f"Twin and optimizer take over {self._file.value}? The twin and the optimizer use them at once. "
            "The driver keeps its own, and at the next start all nodes have "
            "theirs again: ./worm start --parameters FILE gives them these for good."
        )
        self._dialog.open()

    def _take_over(self) -> None:
        self._dialog.close()
        name = self._file.value
        try:
            own = name != _STARTED
            file = self._hub.shelf.parameter_file(name) if own else self._studies.started
            if self._may_take():
                self._begun(self._studies.take_over(file), "")
        except InputError as error:
            _warn(str(error))

    # --- what is shown -----------------------------------------------------------------------

    def _tell(self) -> None:
        studies, hub = self._studies, self._hub
        searching, identifying = studies.searching, studies.identifying
        self._how_far.set_text(searching)
        bags = ", ".join(self._chosen())
        self._bags.set_text(
            f"From {bags}" if bags else "From the bags that are chosen in Recordings: none so far"
        )
        self._identify.set_enabled(not identifying)
        self._end.set_enabled(bool(identifying))
        self._stage.set_text(identifying)
        used = hub.parameter_file
        self._used.set_text(f"In use: {used.rsplit('/', 1)[-1] if used else 'the paper’s values'}")
        names = [_STARTED, *hub.shelf.identified()]
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
