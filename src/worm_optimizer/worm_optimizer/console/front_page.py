# SPDX-License-Identifier: Apache-2.0
"""Chart of the front on the cockpit, and the buttons that choose a gait on it."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from nicegui import events, ui

from worm_model.errors import InputError
from worm_msgs.gait import FORWARD, REVERSE, Gait
from worm_optimizer.console import page_actions
from worm_optimizer.console.charts import Axis, axis_of, dots
from worm_optimizer.console.console_state import ConsoleState
from worm_optimizer.console.gait_fields import LIMITS
from worm_optimizer.console.page_actions import Front
from worm_optimizer.gait_prediction import Prediction
from worm_optimizer.nodes.operator_node import DRIVER, OperatorNode
from worm_optimizer.nodes.robot_client import OperatorError
from worm_optimizer.search.gait_request import SAME_LENGTH

_READING = "reading the front"
_DIRECTIONS = {FORWARD: "Forward", REVERSE: "Reverse"}
_WALK = {
    **dict.fromkeys(("ArrowLeft", "ArrowDown"), -1),
    **dict.fromkeys(("ArrowRight", "ArrowUp"), 1),
    "Home": -1000,
    "End": 1000,
}
# A click selects the gait whose speed is nearest to the place of the click. It belongs to the chart and not to a point,
# so that it also counts if the points are drawn again between the press and the release.
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


class ActionButton:
    """Button that shows the reason why it cannot be pressed."""

    def __init__(self, name: str, press: Callable[[], None]) -> None:
        self.button = ui.button(name, on_click=press).props("dense padding='xs' size=13px")
        with self.button:
            self._reason = ui.tooltip()

    def forbid(self, reason: str) -> None:
        """Disable the button for a reason; enable it if the reason is empty."""
        self.button.set_enabled(not reason)
        self._reason.set_text(reason)
        self._reason.set_visibility(bool(reason))


class FrontChart:
    """Front of a direction, of which one gait can be chosen.

    Args:
        state: shared state of the pages.
        choose: called with a gait that a person chooses on the front.
        turn: called when a person changes the direction.
    """

    def __init__(
        self,
        state: ConsoleState,
        choose: Callable[[Prediction], None],
        turn: Callable[[], None],
    ) -> None:
        self._state, self._choose = state, choose
        self._gait: Gait | None = None  # gait that is marked if it is on the front
        self._shown: Front | None = None
        self._hint = ""  # what is wrong with the speed of "At a speed"
        with ui.row().classes("items-center gap-2 w-full"):
            self._direction = ui.toggle(_DIRECTIONS, value=FORWARD, on_change=turn).props("dense")
            self._read = ActionButton("Read front", self._read_front)
        self._chart = ui.html("", sanitize=False).classes("w-full chart front")
        self._chart.props(
            'role=slider tabindex=0 aria-label="Gaits of the front: power over speed"'
        )
        self._chart.on("click", self._on_click, js_handler=_CLICKED)
        self._chart.on("keydown", self._on_key, js_handler=_KEYS)
        self._objectives = []
        with ui.row().classes("items-center gap-1 w-full"):
            for name, find in (
                ("Least power", lambda front: front.gaits[0]),
                ("Cruise", lambda front: front.cruise),
                ("Fastest", lambda front: front.gaits[-1]),
                ("At a speed", self._at_speed),
            ):
                self._objectives.append(ActionButton(name, partial(self._find, find)))
            self._speed = ui.number("mm/s").props('dense aria-label="Speed, mm/s"').classes("w-12")
        self._note = ui.label().classes("note front-note").props("role=status")
        self.show(None)

    @property
    def direction(self) -> int:
        """Direction of the gaits."""
        return int(self._direction.value)

    def show(self, gait: Gait | None) -> None:
        """Show the present front. Mark a gait if it is on this front."""
        self._gait, self._shown = gait, self._state.fronts.get(self.direction)
        if self._shown is None:
            self._describe('<div class="area"></div>', 0, 0, "no front")
            return
        points = [(1e3 * each.speed, each.power) for each in self._shown.gaits]
        x, y = _axes(self._shown)
        chosen = self._chosen()
        drawn = f'<div class="legend"><b>{y.name}</b></div>{dots(x, y, points, chosen)}'
        if chosen is None:
            self._describe(drawn, len(points), 0, "none chosen")
        else:
            text = "{:.2f} mm/s, {:.2f} W".format(*points[chosen])
            self._describe(drawn, len(points), chosen + 1, text)

    def refresh(self) -> None:
        """Read a missing front, show a new one, and update buttons and note."""
        state = self._state
        if self.direction not in state.front_notes and state.snapshot().driver is not None:
            self._read_front()
        if state.fronts.get(self.direction) is not self._shown:
            self.show(self._gait)
        self._read.forbid(state.worker.failure)
        for button in self._objectives:
            button.forbid("" if self._shown else "there is no front")
        self._note.set_text(self._hint + self._front_note())

    def _describe(self, drawn: str, count: int, chosen: int, text: str) -> None:
        """Show a chart, and what a screen reader says about it."""
        self._chart.set_content(drawn)
        self._chart.props(
            f'aria-valuemin=0 aria-valuemax={count} aria-valuenow={chosen} aria-valuetext="{text}"'
        )

    def _chosen(self) -> int | None:
        """Return the index of the marked gait; None if it is not on the front."""
        gaits = [] if self._shown is None else [each.gait for each in self._shown.gaits]
        return gaits.index(self._gait) if self._gait in gaits else None

    def _read_front(self) -> None:
        """Read the front, its conditions, and the driver's limits. A change of the end of the front is explained."""
        state, direction = self._state, self.direction
        length, before = page_actions.initial_length(state.twin()), state.fronts.get(direction)
        state.front_notes[direction] = _READING

        def read(node: OperatorNode) -> str:
            try:
                front = page_actions.read_front(node, direction, length)
                state.conditions = node.conditions()
                state.limits = node.numbers(DRIVER, LIMITS)
            except (OperatorError, InputError) as error:
                state.front_notes[direction] = f"no front: {error}"
                return ""
            state.fronts[direction] = front
            state.front_notes[direction] = page_actions.described(front, before)
            return ""

        state.worker.submit_quietly(read)

    def _on_click(self, event: events.GenericEventArguments) -> None:
        if self._shown is not None:
            speed, _ = _axes(self._shown)
            wanted = speed.low + float(event.args) * (speed.high - speed.low)
            self._find(
                lambda front: min(front.gaits, key=lambda gait: abs(1e3 * gait.speed - wanted))
            )

    def _on_key(self, event: events.GenericEventArguments) -> None:
        chosen = self._chosen()
        wanted = int(event.args) + (-1 if chosen is None else chosen)
        self._find(lambda front: front.gaits[min(max(wanted, 0), len(front.gaits) - 1)])

    def _find(self, find: Callable[[Front], Prediction | None]) -> None:
        self._hint = ""
        if self._shown is not None and (found := find(self._shown)) is not None:
            self._choose(found)

    def _at_speed(self, front: Front) -> Prediction | None:
        """Return the gait of least power among those of the front that are fast enough."""
        wanted, fastest = self._speed.value, 1e3 * front.gaits[-1].speed
        if wanted is None or not 0.0 < wanted <= fastest:
            self._hint = f"Enter a speed above 0 and up to {fastest:.2f} mm/s, the fastest gait's. "
            return None
        enough = [gait for gait in front.gaits if 1e3 * gait.speed >= wanted]
        return min(enough, key=lambda gait: gait.power)

    def _front_note(self) -> str:
        """Return the note about the front, and that it has to be read again after a change of the groove phase."""
        note = self._state.front_notes.get(self.direction, "")
        change = page_actions.phase_change(self._state.twin(), self._shown)
        if abs(change) < SAME_LENGTH or note == _READING:
            return note
        return (
            f"The groove phase has changed by {1e3 * change:+.1f} mm: read the front again. {note}"
        )


def _axes(front: Front) -> tuple[Axis, Axis]:
    return (
        axis_of("robust speed, mm/s", [1e3 * gait.speed for gait in front.gaits], 6),
        axis_of("robust power, W", [gait.power for gait in front.gaits]),
    )
