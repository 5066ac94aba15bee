# SPDX-License-Identifier: Apache-2.0
"""The page of the console: tabs, and below all of them control and STOP."""

from __future__ import annotations

import tempfile
from pathlib import Path

from fastapi import Response
from fastapi.responses import FileResponse, PlainTextResponse
from nicegui import Client, app, events, ui
from starlette.background import BackgroundTask

from worm_model.analysis.plot_style import BLUE
from worm_model.errors import InputError
from worm_optimizer.console.act_page import ActPage
from worm_optimizer.console.console_state import ConsoleState
from worm_optimizer.console.live_page import LivePage
from worm_optimizer.console.page_frame import head
from worm_optimizer.console.recordings_page import RecordingsPage
from worm_optimizer.console.view import SAMPLE_S, state_text

REFRESH_S = 0.25
_SANDBOX = {"content-security-policy": "sandbox"}  # blocks scripts in a report of a foreign bag
_NO_CONTROL = "this page does not have control"


def build(state: ConsoleState) -> None:
    """Register the pages with the server."""

    @ui.page("/", title="Worm console")
    def console(client: Client) -> None:
        ConsolePage(state, client)

    @app.get("/reports/{name:path}")
    def report(name: str) -> Response:
        try:
            page = state.library.report(name)
            return FileResponse(page, media_type="text/html", headers=_SANDBOX)
        except InputError as error:
            return PlainTextResponse(str(error), 404)

    @app.get("/bags/{name:path}")
    async def bag(name: str) -> Response:
        folder = tempfile.TemporaryDirectory(prefix="worm_console_")
        try:
            packed = await state.library.packed(name, Path(folder.name))
        except InputError as error:
            folder.cleanup()
            return PlainTextResponse(str(error), 404)
        return FileResponse(packed, filename=packed.name, background=BackgroundTask(folder.cleanup))

    app.timer(SAMPLE_S, lambda: state.history.add(state.snapshot()))


class ConsolePage:
    """One page in one browser, from its opening to its end."""

    def __init__(self, state: ConsoleState, client: Client) -> None:
        self._state, self._client, self._id = state, client, client.id
        self._latest_notice = state.notices[-1] if state.notices else None
        ui.add_head_html(head(state.control.timeout_s))
        ui.on("alive", self._on_alive)
        client.on_disconnect(lambda: self._lose_control("this page lost its connection"))
        client.on_delete(lambda: state.control.forget(self._id))
        ui.colors(primary=BLUE)  # white text on it is legible in the sun
        dark = ui.dark_mode(None)
        with ui.header().classes("items-center gap-2 q-py-xs"):
            ui.html("Worm console", tag="h1", sanitize=False).classes("text-h6")
            self._state_label = ui.label().classes("grow line").props("role=status")
            ui.button(icon="dark_mode", on_click=lambda: _toggle(dark)).props(
                'flat color=white aria-label="Light or dark"'
            )
        self._tabs()
        self._footer()
        ui.timer(REFRESH_S, self._refresh)

    def _tabs(self) -> None:
        state = self._state
        with ui.tabs().classes("w-full") as tabs:
            live, act, recordings = ui.tab("Live"), ui.tab("Act"), ui.tab("Recordings")
        with ui.tab_panels(tabs, value=live).classes("w-full"):
            with ui.tab_panel(live):
                LivePage(state, lambda: tabs.value == "Live")
            with ui.tab_panel(act):
                ActPage(state, self._why_not)
            with ui.tab_panel(recordings):
                bags = RecordingsPage(state)
        tabs.on_value_change(lambda event: bags.read() if event.value == "Recordings" else None)

    def _footer(self) -> None:
        with ui.footer().classes("items-center gap-2 q-py-xs"):
            ui.element("div").props("id=connection role=alert")
            self._take = ui.button("Take control", on_click=self._toggle_control)
            self._hand_over = ui.button("Hand over", on_click=self._on_hand_over)
            for button, colour in ((self._take, "white"), (self._hand_over, "amber")):
                button.props(f"color={colour} text-color=black").classes("needs-connection")
            self._holder = ui.label().classes("line needs-connection")
            self._status = (
                ui.label()
                .classes("line order-first w-full sm:order-none sm:w-0 sm:grow")
                .props("role=status")
            )
            ui.button("STOP (Esc)", on_click=self._stop).props("id=stop color=red-10").classes(
                "stop ml-auto"
            )

    # --- control -----------------------------------------------------------------------------

    def _why_not(self) -> str:
        """Return the reason why this page may not command the robot; empty if it may."""
        control = self._state.control
        if control.is_held_by(self._id):
            return ""
        if control.is_requested_by(self._id):
            return f"{_NO_CONTROL}: it is requested"
        return f"{control.loss_of(self._id) or _NO_CONTROL}: {self._control_action()}"

    def _on_alive(self, event: events.GenericEventArguments) -> None:
        """Handle a message of the page. Its argument is True if the connection was interrupted since the last one."""
        if event.args:
            self._lose_control("this page had no connection")
        self._state.control.on_message(self._id)
        self._client.run_javascript("acknowledge()")

    def _lose_control(self, reason: str) -> None:
        self._state.control.release(self._id, f"{reason} and lost control")

    def _toggle_control(self) -> None:
        control = self._state.control
        if control.is_held_by(self._id) or control.is_requested_by(self._id):
            control.release(self._id)
        else:
            control.request(self._id)
        self._refresh()

    def _on_hand_over(self) -> None:
        self._state.control.hand_over(self._id)
        self._refresh()

    def _stop(self) -> None:
        self._state.worker.stop()
        self._refresh()

    def _control_action(self) -> str:
        """Return the text of the button for control."""
        control = self._state.control
        if control.is_held_by(self._id):
            return "Release control"
        if control.is_requested_by(self._id):
            return "Withdraw request"
        return "Ask for control" if control.holder else "Take control"

    def _control_text(self) -> str:
        """Return a sentence about the page that has control; empty if no page has it.

        If this page has control, the sentence also names a page that requests it.
        """
        control = self._state.control
        if control.is_held_by(self._id):
            asks = control.requester and f"; {control.requester} asks for it"
            return f"This page has control{asks}."
        return f"Control: {control.holder}." if control.holder else ""

    # --- what is shown -----------------------------------------------------------------------

    def _refresh(self) -> None:
        state = self._state
        snapshot = state.snapshot()
        held = state.control.is_held_by(self._id)
        self._state_label.set_text(state_text(snapshot, stopping=state.worker.stopping))
        self._take.set_text(self._control_action())
        self._take.set_enabled(snapshot.control is not None)
        self._holder.set_text(self._control_text())
        self._hand_over.set_visibility(held and bool(state.control.requester))
        self._status.set_text(state.status_text())
        newest = state.notices[-1] if state.notices else None
        if newest is not self._latest_notice and newest is not None:
            self._latest_notice = newest
            if not newest.good:
                ui.notify(newest.text, type="negative", multi_line=True, timeout=10000)


def _toggle(dark: ui.dark_mode) -> None:
    dark.value = not dark.value
