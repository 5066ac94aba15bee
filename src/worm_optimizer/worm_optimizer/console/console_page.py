# SPDX-License-Identifier: Apache-2.0
"""The page of the console, with its tabs and below them control, state and STOP, and the web server of the page."""

from __future__ import annotations

import logging
from collections.abc import Callable
from contextlib import nullcontext

from fastapi import Response
from fastapi.responses import FileResponse, PlainTextResponse
from nicegui import Client, app, core, events, ui
from nicegui.server import Server
from starlette.middleware.trustedhost import TrustedHostMiddleware

from worm_model.analysis.plot_style import BLUE
from worm_model.errors import InputError
from worm_optimizer.console.cockpit_page import CockpitPage
from worm_optimizer.console.console_state import ConsoleState
from worm_optimizer.console.page_frame import head
from worm_optimizer.console.recordings_page import RecordingsPage
from worm_optimizer.console.view import SAMPLE_S, state_text

REFRESH_S = 0.25
COCKPIT, RECORDINGS = "Cockpit", "Recordings"
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

    app.timer(SAMPLE_S, state.add_sample)


class ConsolePage:
    """One page in one browser, from its opening to its end."""

    def __init__(self, state: ConsoleState, client: Client) -> None:
        self._state, self._client, self._id = state, client, client.id
        ui.add_head_html(head(state.control.timeout_s))
        ui.on("alive", self._on_alive)
        client.on_disconnect(lambda: self._lose_control("this page lost its connection"))
        client.on_delete(lambda: state.control.forget(self._id))
        ui.colors(primary=BLUE)  # white text on it is legible in the sun
        dark = ui.dark_mode(None)
        with ui.row().classes("items-center gap-x-4 gap-y-0 w-full"):
            ui.html("Worm console", tag="h1", sanitize=False)
            with ui.tabs(value=COCKPIT).props("dense") as tabs:
                ui.tab(COCKPIT)
                ui.tab(RECORDINGS)
            toggle = ui.button(icon="dark_mode", on_click=lambda: dark.set_value(not dark.value))
            toggle.props('flat dense aria-label="Light or dark"')
            self._message = ui.label().classes("line message").props("id=message role=status")
        with ui.tab_panels(tabs, value=COCKPIT).classes("w-full"):
            with ui.tab_panel(COCKPIT):
                CockpitPage(state, self._why_not, lambda: tabs.value == COCKPIT)
            with ui.tab_panel(RECORDINGS):
                bags = RecordingsPage(state)
        tabs.on_value_change(lambda event: bags.read() if event.value == RECORDINGS else None)
        self._footer()
        ui.timer(REFRESH_S, self._refresh)

    def _footer(self) -> None:
        with ui.footer().classes("footer"):
            ui.element("div").props("id=connection role=alert")
            with ui.element("div").classes("state"):
                self._state_label = ui.label().props("id=state role=status")
                self._holder = ui.label().classes("needs-connection").props("id=control")
            self._take = ui.button("Take control", on_click=self._toggle_control)
            self._hand_over = ui.button("Hand over", on_click=self._on_hand_over)
            for button, colour in ((self._take, "white"), (self._hand_over, "amber")):
                button.props(f"color={colour} text-color=black").classes("needs-connection")
            stop = ui.button("STOP (Esc)", on_click=self._stop)
            stop.props("id=stop color=red-10").classes("stop")

    # --- control -----------------------------------------------------------------------------

    def _why_not(self) -> str:
        """Return the reason why this page may not command the robot; empty if it may."""
        control = self._state.control
        if control.is_held_by(self._id):
            return ""
        if control.requester == self._id:
            return f"{_NO_CONTROL}: it is requested"
        return f"{control.loss_of(self._id) or _NO_CONTROL}: {self._control_action()}"

    def _on_alive(self, event: events.GenericEventArguments) -> None:
        """Handle a message of the page. Its argument is True if the connection was interrupted since the last one."""
        if event.args:
            self._lose_control("this page had no connection")
            # After an interruption, NiceGUI sends older messages once more, and after newer ones.
            for shown in (self._state_label, self._take, self._holder, self._hand_over):
                shown.update()
        self._state.control.on_message(self._id)
        self._client.run_javascript("acknowledge()")

    def _lose_control(self, reason: str) -> None:
        self._state.control.release(self._id, f"{reason} and lost control")

    def _toggle_control(self) -> None:
        control = self._state.control
        if self._id in (control.holder, control.requester):
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
        if control.holder == self._id:
            return "Release control"
        if control.requester == self._id:
            return "Withdraw request"
        return "Ask for control" if control.holder else "Take control"

    def _control_text(self) -> str:
        """Return a sentence about the page that has control; empty if no page has it."""
        control = self._state.control
        if control.holder != self._id:
            return "Another page has control." if control.holder else ""
        asked = "; another page asks for it" if control.requester else ""
        return f"This page has control{asked}."

    # --- what is shown -----------------------------------------------------------------------

    def _refresh(self) -> None:
        state, control = self._state, self._state.control
        snapshot, message = state.snapshot(), state.message()
        self._state_label.set_text(state_text(snapshot, stopping=state.worker.stopping))
        self._take.set_text(self._control_action())
        self._holder.set_text(self._control_text())
        self._hand_over.set_visibility(control.holder == self._id and bool(control.requester))
        self._message.set_text(message.text)
        self._message.classes(remove="error") if message.good else self._message.classes("error")


HOST = "127.0.0.1"
_LOOK_S = 0.1  # period of the checks for the end, s
# Time for which a page without connection may reconnect, as a multiple of the timeout of control. The page loses
# control at once, even if it reconnects later.
_RECONNECT = 3.0


def serve(state: ConsoleState, port: int, ended: Callable[[], int]) -> None:
    """Start the worker, and serve the pages until ``ended`` returns a nonzero number. The caller closes the worker.

    Pages of other sites, which the browser of this computer may show, cannot connect: the host name and the origin of a
    request must be those of the console.
    """
    # The server's own handlers would exit at a second signal without closing the worker.
    Server.capture_signals = lambda _: nullcontext()
    app.timer(_LOOK_S, lambda: app.shutdown() if ended() else None)
    build(state)
    app.add_middleware(TrustedHostMiddleware, allowed_hosts=[HOST, "localhost"])
    core.sio.eio.cors_allowed_origins = None  # only the console's own origin
    app.on_startup(state.worker.start)
    logging.getLogger("uvicorn.error").addFilter(_is_no_disconnect)
    ui.run(
        host=HOST,
        port=port,
        title="Worm console",
        dark=None,
        reload=False,
        language="en-US",
        show=False,
        show_welcome_message=False,
        reconnect_timeout=_RECONNECT * state.control.timeout_s,
        ws_ping_interval=None,  # only `PageControl` decides how long a slow page may be silent
    )


def _is_no_disconnect(record: logging.LogRecord) -> bool:
    """Return False for the error that Starlette's middleware raises when a client leaves before the response."""
    return "No response returned" not in str(record.exc_info and record.exc_info[1])
