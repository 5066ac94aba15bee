# SPDX-License-Identifier: Apache-2.0
"""The tab from which the robot is moved: its torque, a gait of the front, and how long."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

from nicegui import events, ui

from worm_model.analysis.plot_style import BLUE, VERMILION
from worm_model.errors import InputError
from worm_model.gait import FORWARD, REVERSE
from worm_optimizer.console import page_actions
from worm_optimizer.console.hub import Hub
from worm_optimizer.console.page_chart import chart
from worm_optimizer.console.view import obstacles
from worm_optimizer.nodes.operator_node import OperatorNode
from worm_optimizer.operation.bring_up import CYCLES
from worm_optimizer.orders import Order, RunProgress
from worm_optimizer.robustness.prediction import Prediction
from worm_optimizer.search.gait_request import GaitRequest, Objective
from worm_optimizer.search.optimizer_errors import OptimizerError

WORDS_S = 0.25
_RECORDED = "Every run is recorded."
_SHOWN = {
    "stroke": ("stroke", 1e3, "mm"),
    "frequency": ("frequency", 1.0, "Hz"),
    "margin": ("margin", 1e3, "mm"),
    "speed": ("speed, robust", 1e3, "mm/s"),
    "nominal_speed": ("speed, nominal", 1e3, "mm/s"),
    "power": ("power, robust", 1.0, "W"),
    "nominal_power": ("power, nominal", 1.0, "W"),
    "cost_of_transport": ("cost of transport, robust", 1.0, ""),
    "nominal_cost_of_transport": ("cost of transport, nominal", 1.0, ""),
    "grooves_per_cycle": ("grooves per cycle", 1.0, ""),
    "groove_phase": ("holds for a groove phase of", 1e3, "mm"),
    "success_probability": ("success, phase known", 1.0, ""),
    "success_probability_any_phase": ("success, any phase", 1.0, ""),
}


class ActPage:
    """``forbidden`` says why this page may move nothing, empty: it may."""

    def __init__(self, hub: Hub, forbidden: Callable[[], str]) -> None:
        self._hub, self._forbidden = hub, forbidden
        self._chosen: Prediction | None = None
        self._shown: list[Prediction] = []
        self._buttons: dict[str, tuple[ui.button, ui.tooltip]] = {}
        with ui.row().classes("gap-2"):
            self._button("Home", partial(self._ask, "homing", OperatorNode.home))
            self._button(
                "Activate", partial(self._ask, "activating the driver", OperatorNode.activate)
            )
            self._button("Deactivate", partial(self._ask, "deactivating", OperatorNode.deactivate))
            self._release = ui.button(
                "Permit starts",
                on_click=partial(
                    self._ask, "resetting the emergency stop", OperatorNode.reset_emergency_stop
                ),
            )
        with ui.row().classes("w-full gap-4"):
            with ui.column().classes("gap-1").style("flex: 1 1 18rem; min-width: 0"):
                self._front()
            with ui.column().classes("gap-1"):
                self._gait()
        ui.timer(WORDS_S, self._tell)

    def _button(self, name: str, press: Callable[[], None]) -> None:
        button = ui.button(name, on_click=press)
        with button:
            self._buttons[name] = (button, ui.tooltip())

    def _front(self) -> None:
        with ui.row().classes("items-center gap-2"):
            self._direction = ui.toggle({FORWARD: "Forward", REVERSE: "Reverse"}, value=FORWARD)
            self._button("Read front", self._read)
        self._plot = _plot(self._click)
        with ui.row().classes("items-center gap-2"):
            ui.button("Slower gait", on_click=lambda: self._step(-1))
            ui.button("Faster gait", on_click=lambda: self._step(1))
        with ui.row().classes("items-center gap-2"):
            self._speed = ui.number("At a speed of, mm/s", min=0.0).classes("w-40")
            ui.button("Find gait", on_click=self._find)
        self._why = ui.label().props("role=alert")

    def _gait(self) -> None:
        with ui.grid(columns=2).classes("gap-x-4 gap-y-0 numbers"):
            self._cells = {}
            for key, (name, _, unit) in _SHOWN.items():
                ui.label(f"{name}, {unit}" if unit else name)
                self._cells[key] = ui.label("–").classes("value")
        with ui.row().classes("items-center gap-2"):
            self._count = ui.number("How many", value=CYCLES, min=1, precision=0).classes("w-24")
            self._unit = ui.toggle(["cycles", "grooves"], value="cycles")
        self._button("Run", self._run)
        self._why_not = ui.label(_RECORDED)

    # --- what is pressed ---------------------------------------------------------------------

    def _ask(self, doing: str, act: Callable[[OperatorNode], str]) -> None:
        if why := self._forbidden():
            ui.notify(why, type="warning")
        elif not self._hub.worker.ask(doing, act):
            ui.notify(self._hub.worker.hindrance, type="warning")

    def _read(self) -> None:
        direction, twin = self._direction.value, self._hub.snapshot().twin
        length = 0.0 if twin is None else twin.initial_length

        def read(node: OperatorNode) -> str:
            front = page_actions.read_front(node, direction, length, self._hub.worker.going)
            self._hub.fronts[direction] = front
            return f"the front has {len(front)} gaits"

        if not self._hub.worker.ask("reading the front", read):
            ui.notify(self._hub.worker.hindrance, type="warning")

    def _click(self, event: events.EChartPointClickEventArguments) -> None:
        self._choose(self._shown[event.data_index])

    def _step(self, by: int) -> None:
        if self._shown:
            here = self._shown.index(self._chosen) if self._chosen in self._shown else -1
            self._choose(self._shown[min(max(here + by, 0), len(self._shown) - 1)])

    def _find(self) -> None:
        if not self._shown:
            self._why.set_text("no front has been read: Read front")
            return
        try:
            request = GaitRequest(Objective.MIN_POWER_AT_SPEED, 1e-3 * (self._speed.value or 0.0))
        except OptimizerError as error:
            self._why.set_text(str(error))
            return
        fast_enough = [gait for gait in self._shown if gait.speed >= request.value]
        if not fast_enough:
            fastest = 1e3 * self._shown[-1].speed
            self._why.set_text(
                f"no gait of the front is as fast; the fastest makes {fastest:.3f} mm/s"
            )
            return
        self._choose(min(fast_enough, key=lambda gait: gait.power))

    def _choose(self, prediction: Prediction) -> None:
        self._chosen = prediction
        self._why.set_text("")
        for key, (_, scale, _) in _SHOWN.items():
            value = getattr(prediction, key)
            self._cells[key].set_text(f"{scale * value:.4g}" if math.isfinite(value) else "–")
        self._plot.options["series"][1]["data"] = [_point(prediction)]
        self._plot.update()

    def _run(self) -> None:
        if self._chosen is None:
            self._why.set_text("choose a gait on the front first")
            return
        try:
            order = Order(self._chosen.gait, **{self._unit.value: int(self._count.value or 0)})
        except InputError as error:
            self._why.set_text(str(error))
            return
        hub = self._hub

        def progress(now: RunProgress) -> None:
            hub.worker.busy = f"running: {now}"

        def run(node: OperatorNode) -> str:
            return page_actions.run(
                node, order, hub.shelf.folder, hub.parameter_file, hub.unwanted, progress
            )

        self._ask("starting the recorder", run)

    # --- what is shown -----------------------------------------------------------------------

    def _tell(self) -> None:
        snapshot, worker = self._hub.snapshot(), self._hub.worker
        reasons = obstacles(snapshot, self._forbidden() or worker.hindrance)
        if not reasons["Run"] and self._chosen is None:
            reasons["Run"] = "choose a gait on the front first"
        reasons["Read front"] = worker.hindrance
        why = reasons["Run"]
        self._why_not.set_text(f"Run cannot be pressed: {why}" if why else _RECORDED)
        for name, (button, tooltip) in self._buttons.items():
            button.set_enabled(not reasons[name])
            tooltip.set_text(reasons[name])
            tooltip.set_visibility(bool(reasons[name]))
        latched = snapshot.driver is not None and snapshot.driver.emergency_stop
        self._release.set_visibility(latched)
        gaits = self._hub.fronts.get(self._direction.value, [])
        if gaits != self._shown:
            self._shown = gaits
            self._plot.options["series"][0]["data"] = [_point(gait) for gait in gaits]
            if self._chosen not in gaits:
                self._chosen = None
                self._plot.options["series"][1]["data"] = []
            self._plot.update()


def _point(gait: Prediction) -> list[float]:
    return [round(1e3 * gait.speed, 3), round(gait.power, 4)]


def _plot(click: Callable[[events.EChartPointClickEventArguments], None]) -> ui.echart:
    points = {"type": "scatter", "symbolSize": 11, "color": BLUE, "data": []}
    chosen = {**points, "symbolSize": 18, "color": VERMILION, "silent": True}
    plot = chart(
        {"name": "robust speed, mm/s", "scale": True},
        "robust power, W",
        [points, {**chosen, "data": []}],
        height="20rem",
        on_point_click=click,
    )
    words = "point => `${point.value[0].toFixed(2)} mm/s, ${point.value[1].toFixed(2)} W`"
    plot.options["tooltip"] = {"trigger": "item", ":formatter": words}
    return plot.classes("front")
