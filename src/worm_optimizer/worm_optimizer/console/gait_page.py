# SPDX-License-Identifier: Apache-2.0
"""Choice of a gait on the cockpit: the front, the gait in numbers, its prediction, the conditions, and the run."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from functools import partial

from nicegui import events, ui

from worm_model.errors import InputError
from worm_msgs.conditions import CONDITION_ROWS, LEVEL, Conditions
from worm_msgs.gait import FORWARD, REVERSE, Gait, Profile
from worm_optimizer.console import page_actions
from worm_optimizer.console.charts import Axis, axis_of, dots
from worm_optimizer.console.console_state import ConsoleState
from worm_optimizer.console.gait_fields import DEFAULTS, FIELDS, edited, field_error
from worm_optimizer.console.page_actions import Front
from worm_optimizer.console.view import MOVING, obstacles
from worm_optimizer.gait_prediction import Prediction
from worm_optimizer.nodes.operator_node import OperatorNode
from worm_optimizer.nodes.service_caller import OperatorError
from worm_optimizer.operation.bring_up import CYCLES
from worm_optimizer.robot_commands import GaitCommand
from worm_optimizer.search.gait_request import SAME_LENGTH

REFRESH_S = 0.25
_ASSUMES = "The optimizer assumes {}."
_DIRECTIONS = {FORWARD: "Forward", REVERSE: "Reverse"}
# Name, factor from the SI unit, field with the margin and field without the margin of each predicted value
_PREDICTED = (
    ("speed, mm/s", 1e3, "speed", "nominal_speed"),
    ("power, W", 1.0, "power", "nominal_power"),
    ("cost of transport", 1.0, "cost_of_transport", "nominal_cost_of_transport"),
    ("grooves per cycle", 1.0, "grooves_per_cycle", "nominal_grooves_per_cycle"),
    ("probability to keep them", 1.0, "success_probability", ""),
    ("… at any groove phase", 1.0, "success_probability_any_phase", ""),
)
_WALK = {
    "ArrowLeft": -1,
    "ArrowDown": -1,
    "ArrowRight": 1,
    "ArrowUp": 1,
    "Home": -1000,
    "End": 1000,
}
# A click selects the gait whose speed is nearest to the place of the click, also during a redraw of the chart.
_CLICKED = """(event) => {
  const area = event.currentTarget.querySelector(".area").getBoundingClientRect();
  emit((event.clientX - area.left) / area.width);
}"""
_KEYS = f"""(event) => {{
  const steps = {_WALK};
  if (!(event.key in steps)) return;
  event.preventDefault();
  emit(steps[event.key]);
}}"""


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
        self._hint = ""  # what is wrong with the speed of "At a speed"
        self._filling = False  # True while the fields are filled with a gait of the front
        self._prediction: Prediction | None = None
        self._remark = ""  # warning about the gait, or the reason why it cannot be predicted
        self._asked: tuple[Gait, float] | None = None  # gait and L0 of the latest request
        self._pending = False  # True until this request is answered
        self._shown: Front | None = None
        self._filled: dict[str, float] = {}
        self._conditions_shown = LEVEL
        self._buttons: dict[str, tuple[ui.button, ui.tooltip]] = {}

    # --- parts of the page ---------------------------------------------------------------------

    def front(self) -> None:
        """Build the chart of the front, and the buttons that choose a gait on it."""
        with ui.row().classes("items-center gap-2 w-full"):
            self._direction = ui.toggle(_DIRECTIONS, value=FORWARD, on_change=self._turn).props(
                "dense"
            )
            self._button("Read front", self._read_front)
        self._chart = ui.html("", sanitize=False).classes("w-full chart front")
        self._chart.props(
            'role=slider tabindex=0 aria-label="Gaits of the front: power over speed"'
        )
        self._chart.on("click", self._on_click, js_handler=_CLICKED)
        self._chart.on("keydown", self._on_key, js_handler=_KEYS)
        self._show_front()
        with ui.row().classes("items-center gap-1 w-full"):
            for name, choose in (
                ("Least power", lambda front: front.gaits[0]),
                ("Cruise", lambda front: front.cruise),
                ("Fastest", lambda front: front.gaits[-1]),
                ("At a speed", self._at_speed),
            ):
                self._button(name, partial(self._choose_objective, choose))
            self._speed = ui.number("mm/s").props('dense aria-label="Speed, mm/s"').classes("w-12")
        self._note = ui.label().classes("note front-note").props("role=status")

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
                name: _field(field.title, field.scale * DEFAULTS[name], self._edit)
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
            ):
                self._button(name, partial(self._submit, doing, command))
            self._button("Deactivate", self._deactivate)
            reset = OperatorNode.reset_emergency_stop
            self._button("Permit starts", partial(self._submit, "permitting starts", reset))

    def _button(self, name: str, press: Callable[[], None]) -> None:
        button = ui.button(name, on_click=press).props("dense padding='xs' size=13px")
        with button:
            self._buttons[name] = (button, ui.tooltip())

    # --- commands ------------------------------------------------------------------------------

    def _submit(self, description: str, command: Callable[[OperatorNode], str]) -> None:
        if not self._why_not():
            self._state.worker.submit(description, command)

    def _deactivate(self) -> None:
        """Deactivate the driver, after the end of the present command."""
        if not self._why_not():
            self._state.worker.submit_next("deactivating", OperatorNode.deactivate)

    def _run(self) -> None:
        state = self._state
        if self._gait is None or self._obstacle():
            return
        try:
            command = GaitCommand(self._gait, **{self._unit.value: int(self._count.value or 0)})
        except InputError as error:
            self._run_note.set_text(str(error))
            return
        folder, parameter_file = state.library.folder, state.parameter_file

        def run(node: OperatorNode) -> str:
            return page_actions.run(
                node, command, folder, parameter_file, state.cancellation, state.worker.report
            )

        state.control.begin_run()
        self._submit("starting the recorder", run)

    def _obstacle(self) -> str:
        """Return the reason why the gait of the fields cannot run; empty if it can."""
        state, gait = self._state, self._gait
        if wrong := self._error or (gait is not None and state.limits.obstacle(gait)):
            return wrong
        hindrance = state.worker.hindrance
        if reason := obstacles(state.snapshot(), self._why_not(), hindrance)["Run"]:
            return reason
        if gait is None:
            return "choose a gait on the front, or enter one"
        return "" if self._prediction else self._remark or "the prediction is being computed"

    # --- the front -----------------------------------------------------------------------------

    def _turn(self) -> None:
        self._show_front()
        self._edit()

    def _read_front(self) -> None:
        """Read the front and the driver's limits. A change of the end of the front is explained."""
        state, direction = self._state, self._direction.value
        length, before = state.initial_length(), state.fronts.get(direction)
        state.front_notes[direction] = "reading the front"

        def read(node: OperatorNode) -> str:
            try:
                front = page_actions.read_front(node, direction, length)
                state.conditions = node.conditions()
                state.limits = page_actions.driver_limits(node)
            except OperatorError as error:
                state.front_notes[direction] = f"no front: {error}"
                return ""
            state.fronts[direction] = front
            state.front_notes[direction] = _described(front, before)
            return ""

        state.worker.submit_quietly(read)

    def _on_click(self, event: events.GenericEventArguments) -> None:
        if self._shown is None:
            return
        speed = self._axes(self._shown)[0]
        wanted = speed.low + float(event.args) * (speed.high - speed.low)
        gaits = self._shown.gaits
        self._choose(min(gaits, key=lambda gait: abs(1e3 * gait.speed - wanted)))

    def _on_key(self, event: events.GenericEventArguments) -> None:
        if self._shown is None:
            return
        gaits, here = self._shown.gaits, self._chosen()
        after = int(event.args) + (here if here is not None else -1)
        self._choose(gaits[min(max(after, 0), len(gaits) - 1)])

    def _choose_objective(self, choose: Callable[[Front], Prediction | None]) -> None:
        if self._shown is not None and (found := choose(self._shown)) is not None:
            self._choose(found)

    def _at_speed(self, front: Front) -> Prediction | None:
        """Return the gait of least power among those of the front that are fast enough."""
        wanted, fastest = self._speed.value, 1e3 * front.gaits[-1].speed
        if wanted is None or not 0.0 < wanted <= fastest:
            self._hint = (
                f"Enter a speed above 0 and up to {fastest:.2f} mm/s, that of the fastest gait. "
            )
            return None
        enough = [gait for gait in front.gaits if 1e3 * gait.speed >= wanted]
        return min(enough, key=lambda gait: gait.power)

    def _chosen(self) -> int | None:
        """Return the index of the gait of the fields on the displayed front; None if it is not on it."""
        if self._shown is None or self._gait is None:
            return None
        gaits = [prediction.gait for prediction in self._shown.gaits]
        return gaits.index(self._gait) if self._gait in gaits else None

    def _choose(self, prediction: Prediction) -> None:
        """Choose a gait of the front: show it in the fields, with its prediction."""
        self._gait, self._prediction = prediction.gait, prediction
        self._error = self._hint = self._remark = ""
        self._filled = {
            name: round(field.scale * getattr(prediction, name), 4)
            for name, field in FIELDS.items()
        }
        self._filling = True
        for name, value in self._filled.items():
            self._fields[name].set_value(value)
        self._profile.set_value(str(prediction.profile))
        self._filling = False
        self._show_front()
        self._show_prediction()

    # --- the gait in numbers -------------------------------------------------------------------

    def _edit(self) -> None:
        """Read the gait of the fields. The old prediction no longer holds if it has changed."""
        shown = {name: _value(field) for name, field in self._fields.items()}
        empty = math.isnan(shown["stroke"]) and math.isnan(shown["frequency"])
        if self._filling or (self._gait is None and empty):
            return
        changed = {
            name: value / FIELDS[name].scale
            for name, value in shown.items()
            if self._gait is None or value != self._filled.get(name)
        }
        self._error = field_error({n: v / FIELDS[n].scale for n, v in shown.items()})
        if self._error:
            return
        profile = Profile(self._profile.value)
        gait = edited(self._gait, changed, self._direction.value, profile)
        self._filled = shown
        if gait != self._gait:
            self._gait, self._prediction, self._remark = gait, None, ""
            self._show_front()
            self._show_prediction()

    def _predict(self) -> None:
        """Request the prediction of the gait, again when the robot has another length at rest."""
        gait, length = self._gait, self._state.initial_length()
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
            if gait == self._gait:
                self._prediction, self._remark = prediction, remark
            self._pending = False
            return ""

        self._state.worker.submit_quietly(predict)

    def _set_conditions(self) -> None:
        state = self._state
        try:
            stated = Conditions(**{name: _value(f) for name, f in self._conditions.items()})
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
        direction = self._direction.value
        if direction not in state.front_notes and snapshot.driver is not None:
            self._read_front()
        self._predict()
        obstacle = self._obstacle()
        moves = snapshot.driver is not None and snapshot.driver.state in MOVING
        reasons = obstacles(snapshot, why, worker.hindrance) | {
            "Run": obstacle,
            "Read front": worker.failure,
            "Permit starts": why or worker.hindrance,
            "Set conditions": why or worker.hindrance or ("the robot moves" if moves else ""),
        }
        for name, (button, tooltip) in self._buttons.items():
            reason = reasons.get(name, "" if self._shown else "there is no front")
            button.set_enabled(not reason)
            tooltip.set_text(reason)
            tooltip.set_visibility(bool(reason))
        latched = snapshot.driver is not None and snapshot.driver.emergency_stop
        self._buttons["Permit starts"][0].set_visibility(latched)
        self._run_note.set_text(
            f"Run is not possible: {obstacle}"
            if obstacle
            else f"Every run is recorded. {self._remark}"
        )
        self._note.set_text(self._front_note())
        if state.fronts.get(direction) is not self._shown:
            self._show_front()
        self._show_prediction()
        self._show_conditions()

    def _front_note(self) -> str:
        """Return the note about the front, and that it has to be read again after a change of the groove phase."""
        note = self._hint + self._state.front_notes.get(self._direction.value, "")
        twin, front = self._state.twin(), self._shown
        if twin is None or front is None:
            return note
        if abs(twin.groove_phase - front.groove_phase) < SAME_LENGTH:
            return note
        phase = 1e3 * twin.groove_phase
        return f"The groove phase is now {phase:.1f} mm: read the front again. {note}"

    def _axes(self, front: Front) -> tuple[Axis, Axis]:
        return (
            axis_of("robust speed, mm/s", [1e3 * gait.speed for gait in front.gaits], 6),
            axis_of("robust power, W", [gait.power for gait in front.gaits]),
        )

    def _show_front(self) -> None:
        self._shown = front = self._state.fronts.get(self._direction.value)
        if front is None:
            self._chart.set_content('<div class="area"></div>')
            self._chart.props(
                'aria-valuemin=0 aria-valuemax=0 aria-valuenow=0 aria-valuetext="no front"'
            )
            return
        points = [(1e3 * gait.speed, gait.power) for gait in front.gaits]
        chosen = self._chosen()
        x, y = self._axes(front)
        title = f'<div class="legend"><b>{y.name}</b></div>'
        self._chart.set_content(title + dots(x, y, points, chosen))
        text = "none chosen" if chosen is None else "{:.2f} mm/s, {:.2f} W".format(*points[chosen])
        now = 0 if chosen is None else chosen + 1
        self._chart.props(
            f'aria-valuemin=0 aria-valuemax={len(points)} aria-valuenow={now} aria-valuetext="{text}"'
        )

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


def _described(front: Front, before: Front | None) -> str:
    """Return what there is to say about a front, and why it ends elsewhere than the one before."""
    text = f"For groove phase {1e3 * front.groove_phase:.1f} mm: {front.description}"
    end, old = (1e3 * f.gaits[-1].speed for f in (front, before or front))
    if before is None or abs(end - old) < 0.005:
        return text
    return (
        f"The front now ends at {end:.2f} mm/s; for groove phase {1e3 * before.groove_phase:.1f} mm it ended at "
        f"{old:.2f} mm/s. {text}"
    )


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
