# SPDX-License-Identifier: Apache-2.0
"""The tab Recordings: list with search, reports, and downloads."""

from __future__ import annotations

from functools import partial
from urllib.parse import quote

from nicegui import ui

from worm_model.errors import InputError
from worm_optimizer.console.bag_library import LISTED, cells_of
from worm_optimizer.console.console_state import ConsoleState

_CHECKBOX = '<q-checkbox v-model="props.selected" :aria-label="{}" />'


class RecordingsPage:
    """List of recorded runs. A report replaces the list until "Back to the list" is pressed."""

    def __init__(self, state: ConsoleState) -> None:
        self._state = state
        with ui.element("div").classes("w-full") as self._list:
            self._build_list()
        with ui.element("div").classes("w-full") as self._detail:
            ui.button("Back to the list", icon="arrow_back", on_click=self._back)
            self._shown = ui.element("div").classes("w-full")
        self._detail.set_visibility(False)

    def _build_list(self) -> None:
        with ui.row().classes("items-center w-full gap-2"):
            ui.button("Read list", on_click=self.read)
            search = ui.input("Search").classes("grow")
        with ui.row().classes("gap-2 q-my-sm"):
            ui.button("Open report", on_click=partial(self._report, 1, "one bag"))
            ui.button("Compare two", on_click=partial(self._report, 2, "two bags"))
            ui.button("Download", on_click=self._download)
        self._note = ui.label().classes("line").props("role=status")
        columns = [
            {"name": key, "field": key, "label": label, "align": "left", "sortable": True}
            for key, label in [("name", "bag"), *((column.key, column.label) for column in LISTED)]
        ]
        self._table = ui.table(
            columns=columns, rows=[], row_key="key", selection="multiple", pagination=20
        ).classes("w-full")
        search.bind_value(self._table, "filter")
        self._table.style("min-height: 40vh")
        self._table.props(
            ':rows-per-page-options="[20]" no-data-label="no run is listed" no-results-label="none"'
        )
        self._table.add_slot("header-selection", _CHECKBOX.format("'Select all'"))
        self._table.add_slot("body-selection", _CHECKBOX.format("'Select ' + props.row.name"))

    async def read(self) -> None:
        """Read the list."""
        self._note.set_text("reading the list")
        try:
            rows = await self._state.library.rows()
        except InputError as error:
            self._note.set_text(str(error))
            return
        self._note.set_text("" if rows else "nothing has been recorded yet")
        cells = [{"key": f"{row['name']} {row['start']}", **cells_of(row)} for row in rows]
        self._table.update_rows(cells)

    def selected(self) -> list[str]:
        """Return the names of the selected bags."""
        return list(dict.fromkeys(row["name"] for row in self._table.selected))

    async def _report(self, count: int, words: str) -> None:
        """Make and show the report of the selected bags, which are ``count``, in words ``words``."""
        names = self.selected()
        if len(names) != count:
            self._note.set_text(f"select {words} in the list")
            return
        self._note.set_text("making the report, which takes some seconds")
        state = self._state
        try:
            report = await state.library.make_report(names, state.parameter_file)
        except InputError as error:
            self._note.set_text(str(error))
            return
        self._note.set_text("")
        self._shown.clear()
        self._list.set_visibility(False)
        self._detail.set_visibility(True)
        with self._shown:
            ui.element("iframe").props(  # without scripts
                f'src="/reports/{quote(report)}" title="Report" sandbox="" '
                'style="width:100%;height:75vh;border:0;background:white"'
            )

    def _back(self) -> None:
        self._shown.clear()
        self._detail.set_visibility(False)
        self._list.set_visibility(True)

    async def _download(self) -> None:
        names = self.selected()
        if not names:
            self._note.set_text("select a bag in the list")
            return
        self._note.set_text("packing")
        try:
            for name in names:
                ui.download.file(await self._state.library.packed(name))
            self._note.set_text("")
        except InputError as error:
            self._note.set_text(str(error))
