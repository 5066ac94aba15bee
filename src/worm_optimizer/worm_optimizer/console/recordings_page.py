# SPDX-License-Identifier: Apache-2.0
"""The tab of what was recorded: a list with a search, reports in the page, two runs compared, bags to take away."""

from __future__ import annotations

from typing import Any
from urllib.parse import quote

from nicegui import ui

from worm_model.commands.bag_table import gait_text
from worm_model.errors import InputError
from worm_optimizer.console.hub import Hub
from worm_optimizer.console.shelf import Row, found

_COLUMNS = (
    ("name", "bag"),
    ("start", "start"),
    ("gait", "gait"),
    ("cycles", "cycles"),
    ("speed", "speed, mm/s"),
    ("power", "power, W"),
    ("cost_of_transport", "cost of transport"),
    ("health", "health"),
)


class RecordingsPage:
    """The list is read when it is asked for."""

    def __init__(self, hub: Hub) -> None:
        self._hub = hub
        self._rows: list[Row] = []
        with ui.row().classes("items-center w-full gap-2"):
            ui.button("Read list", on_click=self.read)
            self._search = ui.input("Search", on_change=self._fill).classes("grow")
        columns = [
            {"name": key, "field": key, "label": label, "align": "left", "sortable": True}
            for key, label in _COLUMNS
        ]
        self._note = ui.label().props("role=status")
        self._table = ui.table(
            columns=columns, rows=[], row_key="key", selection="multiple", pagination=20
        ).classes("w-full")
        self._table.props('no-data-label="no run to show" no-results-label="none"')
        with ui.row().classes("gap-2"):
            ui.button("Open report", on_click=lambda: self._report(1))
            ui.button("Compare two", on_click=lambda: self._report(2))
            ui.button("Download", on_click=self._download)
        self._shown = ui.element("div").classes("w-full")

    async def read(self) -> None:
        """Read the list anew."""
        self._note.set_text("reading")
        try:
            self._rows = await self._hub.shelf.rows()
        except InputError as error:
            self._note.set_text(str(error))
            return
        self._note.set_text("" if self._rows else "nothing has been recorded yet")
        self._fill()

    def _fill(self) -> None:
        rows = found(self._rows, self._search.value or "")
        self._table.update_rows([_shown(row, key) for key, row in enumerate(rows)])

    def chosen(self) -> list[str]:
        """The names of the bags that are chosen in the list."""
        return list(dict.fromkeys(row["name"] for row in self._table.selected))

    async def _report(self, bags: int) -> None:
        names = self.chosen()
        if len(names) != bags:
            self._note.set_text(f"choose {'one bag' if bags == 1 else 'two bags'} in the list")
            return
        self._note.set_text("making the report, which takes some seconds")
        try:
            report = await self._hub.shelf.make_report(names)
        except InputError as error:
            self._note.set_text(str(error))
            return
        self._note.set_text("")
        self._shown.clear()
        with self._shown:
            report_frame(report)

    def _download(self) -> None:
        names = self.chosen()
        if not names:
            self._note.set_text("choose a bag in the list")
        for name in names:
            ui.download.from_url(f"/bags/{quote(name)}")


def report_frame(report: str) -> None:
    """A report in the page, where it can do nothing but be read."""
    ui.element("iframe").props(
        f'src="/reports/{quote(report)}" title="Report" sandbox="" '
        'style="width:100%;height:70vh;border:0;background:white"'
    )


def _shown(row: Row, key: int) -> dict[str, Any]:
    """A row of the table."""
    return {
        "key": key,
        "name": row["name"],
        "start": (row["start"] or "")[:19].replace("T", " "),
        "gait": gait_text(row["gait"]),
        "cycles": row["cycles"],
        "speed": _number(row["speed"], 1e3),
        "power": _number(row["power"], 1.0),
        "cost_of_transport": _number(row["cost_of_transport"], 1.0),
        "health": row["health"] or row["state"],
    }


def _number(value: float | None, scale: float) -> float | None:
    return None if value is None or value != value else round(scale * value, 2)
