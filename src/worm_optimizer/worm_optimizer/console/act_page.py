# SPDX-License-Identifier: Apache-2.0
"""The tab Act: torque, choice of a gait, and its run."""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Callable
from functools import partial

from nicegui import events, ui

from worm_model.analysis.plot_style import BLUE, VERMILION
from worm_model.errors import InputError
from worm_msgs.conditions import CONDITION_ROWS, LEVEL, Conditions
from worm_msgs.gait import FORWARD, GAIT_DEFAULTS, REVERSE, Gait, Profile
from worm_optimizer.console import page_actions
from worm_optimizer.console.console_state import ConsoleState
from worm_optimizer.console.page_chart import chart
from worm_optimizer.console.view import MOVING, live_twin, obstacles
from worm_optimizer.gait_prediction import Prediction
from worm_optimizer.nodes.operator_node import OperatorNode
from worm_optimizer.operation.bring_up import CYCLES
from worm_optimizer.optimizer_errors import OptimizerError
from worm_optimizer.robot_commands import GaitCommand
from worm_optimizer.search.gait_request import GaitRequest, Objective

REFRESH_S = 0.25
_RECORDED = "Every run is recorded."
# Label, factor from the SI unit to the displayed unit, and displayed unit of each value of a gait
_SHOWN = {
    "stroke": ("stroke", 1e3, "mm"),
    "frequency": ("frequency", 1.0, "Hz"),
    "pretension": ("pretension", 1e3, "mm"),
    "contraction_share": ("contraction share", 1.0, ""),
    "ramp_share": ("ramp share of a trapezoid", 1.0, ""),
    "margin": ("margin", 1e3, "mm"),
    "speed": ("speed, robust", 1e3, "mm/s"),
    "nominal_speed": ("speed, nominal", 1e3, "mm/s"),
    "power": ("power, robust", 1.0, "W"),
    "nominal_power": ("power, nominal", 1.0, "W"),
    "cost_of_transport": ("cost of transport, robust", 1.0, ""),
    "nominal_cost_of_transport": ("cost of transport, nominal", 1.0, ""),
    "grooves_per_cycle": ("grooves per cycle", 1.0, ""),
    "groove_phase": ("groove phase", 1e3, "mm"),
    "success_probability": ("success, phase known", 1.0, ""),
    "success_probability_any_phase": ("success, any phase", 1.0, ""),
}
#: fields of "A gait in numbers" with their defaults in SI units, in the order of _SHOWN
_OWN = {
    name: GAIT_DEFAULTS.get(name)
    for name in ("stroke", "frequency", "pretension", "contraction_share", "ramp_share", "margin")
}


class ActPage:
    """Commands to the robot.

    Args:
        state: shared state of the pages.
        why_not: returns the reason why this page may not command the robot; empty if it may.
    """

    def __init__(self, state: ConsoleState, why_not: Callable[[], str]) -> None:
        self._state, self._why_not = state, why_not
        self._chosen: Prediction | None = None  # gait that was chosen on the front
        self._gait: Gait | None = None  # gait to run: the chosen one, or one entered in numbers
        self._conditions_shown = LEVEL
        self._shown: list[Prediction] = []
        self._buttons: dict[str, tuple[ui.button, ui.tooltip]] = {}
        ui.html("Act", tag="h2", sanitize=False).classes("text-lg")
        with ui.row().classes("gap-2"):
            self._button("Home", partial(self._submit, "homing", OperatorNode.home))
            self._button(
                "Activate", partial(self._submit, "activating the driver", OperatorNode.activate)
            )
            self._button(
                "Deactivate", partial(self._submit, "deactivating", OperatorNode.deactivate)
            )
            self._release = ui.button(
                "Permit starts",
                on_click=partial(
                    self._submit, "resetting the emergency stop", OperatorNode.reset_emergency_stop
                ),
            )
        with ui.row().classes("w-full gap-4"):
            with ui.column().classes("gap-1").style("flex: 1 1 18rem; min-width: 0"):
                self._front()
                self._conditions()
                self._own_gait()
            with ui.column().classes("gap-1"):
                self._chosen_gait()
        ui.timer(REFRESH_S, self._refresh)

    def _button(self, name: str, press: Callable[[], None]) -> None:
        button = ui.button(name, on_click=press)
        with button:
            self._buttons[name] = (button, ui.tooltip())

    def _front(self) -> None:
        with ui.row().classes("items-center gap-2"):
            self._direction = ui.toggle({FORWARD: "Forward", REVERSE: "Reverse"}, value=FORWARD)
            self._button("Read front", self._read)
        self._plot = _plot(self._click).props('role=img aria-label="Front: power over speed"')
        with ui.row().classes("items-center gap-2"):
            ui.button("Slower gait", on_click=lambda: self._step(-1))
            ui.button("Faster gait", on_click=lambda: self._step(1))
        with ui.row().classes("items-center gap-2"):
            self._speed = ui.number("At a speed of, mm/s", min=0.0).classes("w-40")
            ui.button("Find gait", on_click=self._find)
        self._error = ui.label().classes("line error").props("role=alert")

    def _conditions(self) -> None:
        with (
            ui.expansion("Conditions in the pipe").classes("w-full"),
            ui.row().classes("items-center gap-2"),
        ):
            self._condition_fields = {
                name: _field(row["option"].strip("-").replace("-", " "), 1.0, row["unit"], 0.0)
                for name, row in CONDITION_ROWS.items()
            }
            self._button("Set conditions", self._set_conditions)
        self._condition_text = ui.label().classes("line")

    def _own_gait(self) -> None:
        with (
            ui.expansion("A gait in numbers").classes("w-full"),
            ui.row().classes("items-center gap-2"),
        ):
            self._fields = {name: _field(*_SHOWN[name], default) for name, default in _OWN.items()}
            self._profile = ui.select(
                [str(profile) for profile in Profile], value=str(Profile.COSINE), label="profile"
            ).classes("w-32")
            ui.button("Use this gait", on_click=self._use_own)

    def _chosen_gait(self) -> None:
        with ui.grid(columns=2).classes("gap-x-4 gap-y-0 numbers"):
            self._cells = {}
            for key, (name, _, unit) in _SHOWN.items():
                ui.label(f"{name}, {unit}" if unit else name)
                self._cells[key] = ui.label("–").classes("value")
        with ui.row().classes("items-center gap-2"):
            self._count = ui.number("How many", value=CYCLES, min=1, precision=0).classes("w-24")
            self._unit = ui.toggle(["cycles", "grooves"], value="cycles")
        self._button("Run", self._run)
        self._run_note = ui.label(_RECORDED).classes("line").style("max-width: 24rem")

    # --- buttons and fields ---------------------------------------------------------------------

    def _submit(self, description: str, command: Callable[[OperatorNode], str]) -> None:
        if why := self._why_not():
            ui.notify(why, type="warning")
        elif not self._state.worker.submit(description, command):
            ui.notify(self._state.worker.hindrance, type="warning")

    def _read(self) -> None:
        direction, twin = self._direction.value, live_twin(self._state.snapshot(), time.monotonic())
        length = 0.0 if twin is None else twin.initial_length

        def read(node: OperatorNode) -> str:
            front = page_actions.read_front(node, direction, length, self._state.worker.progress)
            self._state.conditions = node.conditions()
            self._state.fronts[direction] = front
            return f"the front has {len(front)} gaits"

        if not self._state.worker.submit("reading the front", read):
            ui.notify(self._state.worker.hindrance, type="warning")

    def _set_conditions(self) -> None:
        state = self._state
        try:
            stated = Conditions(
                **{
                    name: float(field.value or 0.0)
                    for name, field in self._condition_fields.items()
                }
            )
        except InputError as error:
            self._error.set_text(str(error))
            return
        values = dataclasses.asdict(stated)

        def apply(node: OperatorNode) -> str:
            node.set_model_parameters(values)
            state.conditions = stated
            state.fronts.clear()
            return f"twin and optimizer assume {stated}"

        self._error.set_text("")
        self._submit("setting the conditions of twin and optimizer", apply)

    def _use_own(self) -> None:
        values = {
            name: float(field.value or 0.0) / _SHOWN[name][1]
            for name, field in self._fields.items()
        }
        try:
            gait = Gait(
                **values,
                direction=self._direction.value,
                profile=Profile[self._profile.value.upper()],
            )
        except InputError as error:
            self._error.set_text(str(error))
            return
        self._choose(None, gait)

    def _click(self, event: events.EChartPointClickEventArguments) -> None:
        self._choose_on_front(self._shown[event.data_index])

    def _step(self, by: int) -> None:
        if self._shown:
            here = self._shown.index(self._chosen) if self._chosen in self._shown else -1
            self._choose_on_front(self._shown[min(max(here + by, 0), len(self._shown) - 1)])

    def _find(self) -> None:
        if not self._shown:
            self._error.set_text("there is no front yet: Read front")
            return
        try:
            request = GaitRequest(Objective.MIN_POWER_AT_SPEED, 1e-3 * (self._speed.value or 0.0))
        except OptimizerError as error:
            self._error.set_text(str(error))
            return
        fast_enough = [gait for gait in self._shown if gait.speed >= request.value]
        if not fast_enough:
            fastest = 1e3 * self._shown[-1].speed
            self._error.set_text(
                f"no gait of the front is this fast; the fastest has {fastest:.3f} mm/s"
            )
            return
        self._choose_on_front(min(fast_enough, key=lambda gait: gait.power))

    def _choose_on_front(self, prediction: Prediction) -> None:
        self._choose(prediction, prediction.gait)

    def _choose(self, prediction: Prediction | None, gait: Gait) -> None:
        """Choose a gait and show its values; ``prediction`` is None for a gait entered in numbers."""
        self._chosen, self._gait = prediction, gait
        self._error.set_text("")
        for key, (_, scale, _) in _SHOWN.items():
            value = getattr(prediction or gait, key, math.nan)
            if key == "ramp_share" and gait.profile is Profile.COSINE:
                value = math.nan
            self._cells[key].set_text(f"{scale * value:.4g}" if math.isfinite(value) else "–")
        self._plot.options["series"][1]["data"] = [] if prediction is None else [_point(prediction)]
        self._plot.update()

    def _run(self) -> None:
        if self._gait is None:
            self._error.set_text("choose a gait on the front first")
            return
        try:
            end = {self._unit.value: int(self._count.value or 0)}
            command = GaitCommand(self._gait, **end)
        except InputError as error:
            self._error.set_text(str(error))
            return
        state = self._state
        folder, parameter_file = state.library.folder, state.parameter_file

        def run(node: OperatorNode) -> str:
            return page_actions.run(
                node, command, folder, parameter_file, state.cancellation, state.worker.report
            )

        if not (self._why_not() or state.worker.hindrance):
            state.control.begin_run()
        self._submit("starting the recorder", run)

    # --- what is shown -----------------------------------------------------------------------

    def _refresh(self) -> None:
        snapshot, worker = self._state.snapshot(), self._state.worker
        reasons = obstacles(snapshot, self._why_not() or worker.hindrance)
        if not reasons["Run"] and self._gait is None:
            reasons["Run"] = "choose a gait on the front first"
        reasons["Read front"] = worker.hindrance
        moves = snapshot.driver is not None and snapshot.driver.state in MOVING
        reasons["Set conditions"] = (
            self._why_not() or worker.hindrance or ("the robot moves" if moves else "")
        )
        self._show_conditions()
        why = reasons["Run"]
        self._run_note.set_text(f"Run is not possible: {why}" if why else _RECORDED)
        for name, (button, tooltip) in self._buttons.items():
            button.set_enabled(not reasons[name])
            tooltip.set_text(reasons[name])
            tooltip.set_visibility(bool(reasons[name]))
        latched = snapshot.driver is not None and snapshot.driver.emergency_stop
        self._release.set_visibility(latched)
        gaits = self._state.fronts.get(self._direction.value, [])
        if gaits != self._shown:
            self._shown = gaits
            self._plot.options["series"][0]["data"] = [_point(gait) for gait in gaits]
            if self._chosen is not None and self._chosen not in gaits:
                self._chosen = self._gait = None
                self._plot.options["series"][1]["data"] = []
            self._plot.update()

    def _show_conditions(self) -> None:
        """Show the present conditions. The fields, which a person may be editing, change only with the conditions."""
        conditions = self._state.conditions
        self._condition_text.set_text(f"The optimizer assumes {conditions}.")
        if conditions != self._conditions_shown:
            self._conditions_shown = conditions
            for name, field in self._condition_fields.items():
                field.set_value(getattr(conditions, name))


def _field(name: str, scale: float, unit: str, value: float | None) -> ui.number:
    """Return a field that shows a value in SI units, multiplied by a scale."""
    shown = None if value is None else scale * value
    return ui.number(f"{name}, {unit}" if unit else name, value=shown).classes("w-36")


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
    text = "point => `${point.value[0].toFixed(2)} mm/s, ${point.value[1].toFixed(2)} W`"
    plot.options["tooltip"] = {"trigger": "item", ":formatter": text}
    return plot.classes("front")
