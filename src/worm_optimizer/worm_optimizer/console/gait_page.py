# SPDX-License-Identifier: Apache-2.0
"""The gait on the cockpit: its choice, its numbers, its prediction, the conditions, and its run."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from functools import partial

from nicegui import ui

from worm_model.errors import InputError
from worm_msgs.conditions import CONDITION_ROWS, LEVEL, Conditions
from worm_msgs.gait import GAIT_DEFAULTS, Gait, Profile
from worm_optimizer.console import page_actions
from worm_optimizer.console.console_state import ConsoleState
from worm_optimizer.console.front_page import ActionButton, FrontChart
from worm_optimizer.console.gait_fields import FIELDS, field_error, rejection
from worm_optimizer.console.view import MOVING, obstacles
from worm_optimizer.gait_prediction import Prediction
from worm_optimizer.nodes.operator_node import OperatorNode
from worm_optimizer.nodes.robot_client import OperatorError
from worm_optimizer.operation.bring_up import CYCLES
from worm_optimizer.robot_commands import GaitCommand
from worm_optimizer.search.gait_request import SAME_LENGTH

REFRESH_S = 0.25
_ASSUMES = "The optimizer assumes {}."
# Name, factor from the SI unit, field with the margin and field without the margin of each predicted value
_PREDICTED = (
    ("speed, mm/s", 1e3, "speed", "nominal_speed"),
    ("power, W", 1.0, "power", "nominal_power"),
    ("cost of transport", 1.0, "cost_of_transport", "nominal_cost_of_transport"),
    ("grooves per cycle", 1.0, "grooves_per_cycle", "nominal_grooves_per_cycle"),
    ("probability, if the model is right", 1.0, "success_probability", ""),
    ("… and at any groove phase", 1.0, "success_probability_any_phase", ""),
)


class GaitPage:
    """Choice of a gait, its prediction, and its run.

    The gait that "Run" runs is always the one of the fields. It was chosen on the front or entered.

    Args:
        state: shared state of the pages.
        why_not: returns the reason why this page may not command the robot; empty if it may.
    """

    def __init__(self, state: ConsoleState, why_not: Callable[[], str]) -> None:
        self._state, self._why_not = state, why_not
        self._gait: Gait | None = None
        self._error = ""  # what is wrong with the fields
        self._filling = False  # True while the fields are filled with a gait of the front
        self._prediction: Prediction | None = None
        self._remark = ""  # warning about the gait, or the reason why it cannot be predicted
        self._asked: tuple[Gait, float] | None = None  # gait and L0 of the latest request
        self._pending = False  # True until this request is answered
        self._filled: dict[str, float] = {}
        self._conditions_shown = LEVEL
        self._buttons: dict[str, ActionButton] = {}

    # --- parts of the page ---------------------------------------------------------------------

    def front(self) -> None:
        """Build the chart of the front."""
        self._front = FrontChart(self._state, self._choose, self._edit)

    def run(self) -> None:
        """Build the prediction and the buttons that run the gait."""
        with ui.element("div").classes("numbers w-full"):
            for text in ("predicted", "with margin", "without"):
                ui.label(text).classes("value" if text != "predicted" else "")
            self._cells = []
            for name, _, _, _ in _PREDICTED:
                ui.label(name)
                self._cells.append([ui.label("–").classes("value") for _ in range(2)])
        with ui.row().classes("items-center gap-2 no-wrap"):
            self._count = ui.number("How many", value=CYCLES, min=1, precision=0)
            self._count.props("dense").classes("w-20")
            self._unit = ui.toggle(["cycles", "grooves"], value="cycles").props("dense")
            self._button("Run", self._run)
        self._run_note = ui.label().classes("note").props("role=status")

    def numbers(self) -> None:
        """Build the fields of the gait and of the conditions."""
        with ui.element("div").classes("fields w-full"):
            self._fields = {
                name: _field(
                    field.title, field.scale * GAIT_DEFAULTS.get(name, math.nan), self._edit
                )
                for name, field in FIELDS.items()
            }
            self._profile = (
                ui.toggle(
                    [str(profile) for profile in Profile],
                    value=str(Profile.COSINE),
                    on_change=self._edit,
                )
                .props('dense aria-label="Profile"')
                .classes("profile")
            )
        with ui.element("div").classes("fields w-full"):
            self._conditions = {
                name: _field(_condition_title(name), 0.0, lambda: None) for name in CONDITION_ROWS
            }
        with ui.row().classes("items-center gap-2"):
            self._button("Set conditions", self._set_conditions)
            self._condition_text = ui.label(_ASSUMES.format(LEVEL)).classes("note grow")
        ui.timer(REFRESH_S, self._refresh)

    def actions(self) -> None:
        """Build the buttons that home the robot and switch its torque."""
        with ui.row().classes("items-center gap-2"):
            for name, doing, command in (
                ("Home", "homing", OperatorNode.home),
                ("Activate", "activating the driver", OperatorNode.activate),
                ("Deactivate", "deactivating", OperatorNode.deactivate),
                ("Permit starts", "permitting starts", OperatorNode.reset_emergency_stop),
            ):
                self._button(name, partial(self._submit, doing, command))

    def _button(self, name: str, press: Callable[[], None]) -> None:
        self._buttons[name] = ActionButton(name, press)

    # --- commands ------------------------------------------------------------------------------

    def _submit(self, description: str, command: Callable[[OperatorNode], str]) -> None:
        """Submit a command, which waits for the end of the present one."""
        if not self._why_not():
            self._state.worker.submit(description, command)

    def _command(self) -> GaitCommand:
        """Return the run of the gait. Raises `InputError` if there is no gait or no admissible end."""
        if self._gait is None:
            raise InputError("choose a gait on the front, or enter one")
        return GaitCommand(self._gait, **{self._unit.value: int(self._count.value or 0)})

    def _run(self) -> None:
        if self._obstacle():
            return
        state, command = self._state, self._command()
        folder, parameter_file = state.library.folder, state.parameter_file

        def run(node: OperatorNode) -> str:
            return page_actions.run(
                node, command, folder, parameter_file, state.cancellation, state.worker.report
            )

        state.control.begin_run()
        state.worker.submit("starting the recorder", run)

    def _obstacle(self) -> str:
        """Return the reason why the gait of the fields cannot run; empty if it can."""
        snapshot, hindrance = self._state.snapshot(), self._state.worker.hindrance
        reason = self._error or obstacles(snapshot, self._why_not(), hindrance)["Run"]
        if reason:
            return reason
        try:
            command = self._command()
        except InputError as error:
            return str(error)
        if reason := rejection(command.gait, self._state.limits):
            return reason
        return "" if self._prediction else self._remark or "the prediction is being computed"

    def _choose(self, prediction: Prediction) -> None:
        """Choose a gait of the front: show it in the fields, with its prediction."""
        self._gait, self._prediction = prediction.gait, prediction
        self._error = self._remark = ""
        self._filled = {
            name: round(field.scale * getattr(prediction, name), 4)
            for name, field in FIELDS.items()
        }
        self._filling = True
        for name, value in self._filled.items():
            self._fields[name].set_value(value)
        self._profile.set_value(str(prediction.profile))
        self._filling = False
        self._front.show(self._gait)
        self._show_prediction()

    # --- the gait in numbers -------------------------------------------------------------------

    def _edit(self) -> None:
        """Read the gait of the fields. The old prediction no longer holds if it has changed."""
        shown = {name: _value(field) for name, field in self._fields.items()}
        empty = math.isnan(shown["stroke"]) and math.isnan(shown["frequency"])
        if self._filling or (self._gait is None and empty):
            return
        # The field of an unchanged value shows fewer digits than the gait has.
        values = {
            name: value / FIELDS[name].scale
            for name, value in shown.items()
            if self._gait is None or value != self._filled.get(name)
        }
        values |= {"direction": self._front.direction, "profile": Profile(self._profile.value)}
        self._error = field_error(shown)
        if self._error:
            self._prediction = self._asked = None
            return
        known = {} if self._gait is None else dataclasses.asdict(self._gait)
        gait = Gait(**(known | values))
        self._filled = shown
        if gait != self._gait:
            self._gait, self._prediction, self._remark = gait, None, ""
            self._front.show(self._gait)
            self._refresh()

    def _predict(self) -> None:
        """Request the prediction of the gait, again when the robot has another length at rest."""
        gait, front = self._gait, self._state.fronts.get(self._front.direction)
        length = page_actions.initial_length(self._state.twin(), front)
        if gait is None or self._error or self._pending:
            return
        asked = self._asked
        if asked is not None and asked[0] == gait and abs(asked[1] - length) < SAME_LENGTH:
            return
        self._asked, self._pending = (gait, length), True

        def predict(node: OperatorNode) -> str:
            prediction = None
            try:
                page_actions.require_optimizer(node)
                prediction, remark = node.predict_gait(gait, length)
            except OperatorError as error:
                remark = str(error)
            if gait == self._gait and not self._error:
                self._prediction, self._remark = prediction, remark
            self._pending = False
            return ""

        self._state.worker.submit_quietly(predict)

    def _set_conditions(self) -> None:
        state = self._state
        try:
            stated = Conditions(**{n: f.value or 0.0 for n, f in self._conditions.items()})
        except InputError as error:
            self._condition_text.set_text(_in_words_of_the_page(str(error)))
            return

        def apply(node: OperatorNode) -> str:
            node.set_model_parameters(dataclasses.asdict(stated))
            state.conditions = stated
            state.fronts.clear()
            state.front_notes.clear()
            return f"twin and optimizer assume {stated}"

        self._submit("setting the conditions of twin and optimizer", apply)

    # --- what is shown -------------------------------------------------------------------------

    def _refresh(self) -> None:
        state, worker = self._state, self._state.worker
        snapshot, why = state.snapshot(), self._why_not()
        self._front.refresh()
        self._predict()
        obstacle = self._obstacle()
        moves = snapshot.driver is not None and snapshot.driver.state in MOVING
        reasons = obstacles(snapshot, why, worker.hindrance) | {
            "Run": obstacle,
            "Permit starts": why or worker.hindrance,
            "Set conditions": why or worker.hindrance or ("the robot moves" if moves else ""),
        }
        for name, button in self._buttons.items():
            button.forbid(reasons[name])
        latched = snapshot.driver is not None and snapshot.driver.emergency_stop
        self._buttons["Permit starts"].button.set_visibility(latched)
        self._run_note.set_text(
            f"Run is not possible: {obstacle}"
            if obstacle
            else self._remark or "Every run is recorded."
        )
        self._show_prediction()
        self._show_conditions()

    def _show_prediction(self) -> None:
        for (_, scale, *names), cells in zip(_PREDICTED, self._cells, strict=True):
            for name, cell in zip(names, cells, strict=True):
                value = getattr(self._prediction, name, math.nan) if name else math.nan
                cell.set_text(f"{scale * value:.4g}" if math.isfinite(value) else "–")

    def _show_conditions(self) -> None:
        """Show the present conditions. The fields, which a person may be editing, change only with the conditions."""
        conditions = self._state.conditions
        if conditions != self._conditions_shown:
            self._conditions_shown = conditions
            self._asked = None  # the prediction holds for other conditions
            self._condition_text.set_text(_ASSUMES.format(conditions))
            for name, field in self._conditions.items():
                field.set_value(getattr(conditions, name))


def _field(title: str, value: float, edit: Callable[[], None]) -> ui.number:
    """Return a narrow field."""
    shown = None if math.isnan(value) else round(value, 4)
    return ui.number(title, value=shown, on_change=edit).props("dense debounce=400")


def _value(field: ui.number) -> float:
    """Return the value of a field, NaN if it is empty."""
    return math.nan if field.value is None else float(field.value)


def _condition_title(name: str) -> str:
    row = CONDITION_ROWS[name]
    return f"{row['option'].strip('-').replace('-', ' ')}, {row['unit']}"


def _in_words_of_the_page(text: str) -> str:
    """Return a message about conditions with the titles of the fields instead of their names."""
    for name in sorted(CONDITION_ROWS, key=len, reverse=True):
        text = text.replace(name, _condition_title(name).split(",")[0])
    return text
