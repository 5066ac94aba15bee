# SPDX-License-Identifier: Apache-2.0
"""The page: tabs, who holds control, and STOP, which is always there."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

from fastapi import Request, Response
from fastapi.responses import FileResponse, PlainTextResponse
from nicegui import Client, app, ui
from starlette.background import BackgroundTask

from worm_model.analysis.plot_style import BLUE
from worm_model.errors import InputError
from worm_optimizer.console.access import Access
from worm_optimizer.console.act_page import ActPage
from worm_optimizer.console.entrance import COOKIE
from worm_optimizer.console.hub import Hub
from worm_optimizer.console.live_page import LivePage
from worm_optimizer.console.page_chart import STYLE
from worm_optimizer.console.recordings_page import RecordingsPage
from worm_optimizer.console.studies import Studies
from worm_optimizer.console.studies_page import StudiesPage
from worm_optimizer.console.view import SAMPLE_S, state_words

WORDS_S = 0.25
_BEAT_MS = 500
_READ_ONLY = {"content-security-policy": "sandbox"}  # a bag of elsewhere has no script run here
_WITHOUT = "this page does not hold control"
# The space bar stops, whatever has the focus, but for where one writes, and does nothing else when it comes up again,
# as at the button that has the focus; and the page says that it lives.
_SCRIPT = f"""<script>
const stopBySpace = (event) => {{
  const written = event.target.closest?.("input:not([type=checkbox], [readonly]), textarea");
  if (event.code !== "Space" || written) return;
  event.preventDefault(); event.stopPropagation();
  if (event.type === "keydown" && !event.repeat) document.querySelector("#stop").click();
}};
addEventListener("keydown", stopBySpace, true);
addEventListener("keyup", stopBySpace, true);
addEventListener("load", () => setInterval(() => emitEvent("beat"), {_BEAT_MS}));
</script>"""
_STYLE = (
    f"<style>{STYLE}"
    + """
.scene svg { width: 100%; max-height: 36vh; display: block }
.worm .pipe { fill: #8d8d99 } .worm .robot { fill: #2659bf } .worm .ghost { fill: #e6b422; opacity: .45 }
.worm .bellows { opacity: .5 } .worm .ghost.bellows { opacity: .25 } .worm .fins { opacity: .9 }
.worm text { font: 8px sans-serif; fill: currentColor }
@media (max-width: 600px) { .worm text { font-size: 14px } }
.worm path.scale { stroke: currentColor; stroke-width: 1.5 }
.numbers .value { text-align: right; font-variant-numeric: tabular-nums }
.silent { color: #c62828 } .body--dark .silent { color: #ff8a80 }
.stop { font-weight: 700; font-size: 1.4rem; min-height: 3.2rem; min-width: 9rem }
.q-footer { z-index: 9000 } .q-notifications__list--bottom { bottom: 9rem } /* nothing ever covers STOP */
</style>"""
)


def build(hub: Hub, access: Access) -> None:
    """Make the pages known to the server."""
    studies = Studies(hub)

    @ui.page("/", title="Worm console")
    def console(request: Request, client: Client) -> None:
        ConsolePage(hub, studies, access, client, request.cookies.get(COOKIE, ""))

    @app.get("/reports/{name:path}")
    def report(name: str) -> Response:
        try:
            page = hub.shelf.report(name)
            return FileResponse(page, media_type="text/html", headers=_READ_ONLY)
        except InputError as error:
            return PlainTextResponse(str(error), 404)

    @app.get("/bags/{name:path}")
    async def bag(name: str) -> Response:
        folder = tempfile.TemporaryDirectory(prefix="worm_console_")
        try:
            packed = await hub.shelf.packed(name, Path(folder.name))
        except InputError as error:
            folder.cleanup()
            return PlainTextResponse(str(error), 404)
        return FileResponse(packed, filename=packed.name, background=BackgroundTask(folder.cleanup))

    app.timer(SAMPLE_S, lambda: hub.history.add(hub.snapshot()))


class ConsolePage:
    """One page in one browser, from its opening to its end."""

    def __init__(
        self, hub: Hub, studies: Studies, access: Access, client: Client, session: str
    ) -> None:
        self._hub, self._access, self._client = hub, access, client
        self._session, self._id = session, client.id
        self._lost = _WITHOUT
        self._told = hub.words[-1] if hub.words else None
        ui.add_head_html(_STYLE + _SCRIPT)
        ui.on("beat", self._beat)
        client.on_disconnect(self._leave)
        client.on_delete(lambda: hub.control.release(self._id))
        ui.colors(primary=BLUE)  # on which white is read in the sun
        dark = ui.dark_mode(None)
        with ui.header().classes("items-center gap-2 q-py-xs"):
            ui.label("worm").classes("text-h6")
            self._state = ui.label().classes("grow").props("role=status")
            ui.button(icon="dark_mode", on_click=lambda: _turn(dark)).props(
                'flat color=white aria-label="Light or dark"'
            )
            if access.needs_secret:
                ui.link("Sign out", "/logout").classes("text-white")
        with ui.tabs().classes("w-full") as tabs:
            live, act = ui.tab("Live"), ui.tab("Act")
            recordings, studied = ui.tab("Recordings"), ui.tab("Studies")
        with ui.tab_panels(tabs, value=live).classes("w-full"):
            with ui.tab_panel(live):
                LivePage(hub)
            with ui.tab_panel(act):
                ActPage(hub, self._forbidden)
            with ui.tab_panel(recordings):
                shelf = RecordingsPage(hub)
            with ui.tab_panel(studied):
                StudiesPage(hub, studies, self._forbidden, shelf.chosen)
        tabs.on_value_change(lambda event: shelf.read() if event.value == "Recordings" else None)
        self._foot()
        ui.timer(WORDS_S, self._tell)

    def _foot(self) -> None:
        with ui.footer().classes("items-center gap-2 q-py-xs"):
            self._take = ui.button("Take control", on_click=self._take_control).props(
                "color=white text-color=black"
            )
            self._hand = ui.button("Hand over", on_click=self._hand_over).props(
                "color=amber text-color=black"
            )
            self._word = (
                ui.label()
                .classes("order-first w-full sm:order-none sm:w-0 sm:grow")
                .props("role=status")
            )
            ui.button("STOP", on_click=self._stop).props(
                'id=stop aria-label="Stop" color=red-10'
            ).classes("stop ml-auto")

    # --- control -----------------------------------------------------------------------------

    def _forbidden(self) -> str:
        """Why this page may move nothing, empty: it may."""
        if not self._access.is_open(self._session):
            return "the session has ended: sign in"
        if self._hub.control.is_held_by(self._id):
            return ""
        return f"{self._lost}: {_control_words(self._hub, self._id)}"

    def _beat(self) -> None:
        if self._access.is_open(self._session):
            self._hub.control.beat(self._id)

    def _leave(self) -> None:
        if not self._client.has_socket_connection:
            self._lose("this page lost its connection, and control with it")

    def _lose(self, why: str) -> None:
        """Let go of control, and say why where somebody comes back to this page."""
        if self._hub.control.is_held_by(self._id):
            self._lost = why
        self._hub.control.release(self._id)

    def _take_control(self) -> None:
        if not self._forbidden():
            self._lose(_WITHOUT)
        elif self._access.is_open(self._session):
            self._lost = _WITHOUT
            if not self._hub.control.take(self._id):
                ui.notify("another page holds control; it was asked to hand it over")
        self._tell()

    def _hand_over(self) -> None:
        self._hub.control.hand_over(self._id)
        self._tell()

    def _stop(self) -> None:
        if self._access.is_open(self._session):
            self._hub.worker.stop()

    # --- what is shown -----------------------------------------------------------------------

    def _tell(self) -> None:
        hub = self._hub
        if not self._access.is_open(self._session):
            hub.control.release(self._id)
            ui.navigate.to("/login")
            return
        self._state.set_text(state_words(hub.snapshot(), time.monotonic()))
        self._take.set_text(_control_words(hub, self._id))
        self._hand.set_visibility(hub.control.is_held_by(self._id) and bool(hub.control.asking))
        newest = hub.words[-1] if hub.words else None
        self._word.set_text(hub.worker.busy or ("" if newest is None else newest.text))
        if newest is not self._told and newest is not None:
            self._told = newest
            if not newest.good:
                ui.notify(newest.text, type="negative", multi_line=True, timeout=10000)


def _control_words(hub: Hub, page: str) -> str:
    if hub.control.is_held_by(page):
        return "Release control"
    return "Ask for control" if hub.control.held else "Take control"


def _turn(dark: ui.dark_mode) -> None:
    """From light or the system's choice to dark, and back."""
    dark.value = not dark.value
