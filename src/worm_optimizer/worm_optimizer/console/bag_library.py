# SPDX-License-Identifier: Apache-2.0
"""Folder of the console's recordings. Pages can access bags below this folder only."""

from __future__ import annotations

import asyncio
import json
import shutil
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory, mkdtemp
from typing import Any

from worm_model.bags.formats.finding import METADATA_FILE
from worm_model.commands.bag_runs import COLUMNS
from worm_model.errors import InputError
from worm_optimizer.operation.processes import executable_command
from worm_optimizer.report.report_page import PAGE

LISTED = tuple(column for column in COLUMNS if column.label)  # columns of the list of recordings

Row = dict[str, Any]


class BagLibrary:
    """Folder of bags, which is created if it is missing.

    Reports and packed bags are written to a temporary folder, which exists as long as this object.
    """

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.folder = folder.resolve()
        self._temporary = TemporaryDirectory(prefix="worm_console_")
        self._packed: Path | None = None  # folder of the latest download
        self._reports: dict[str, Path] = {}  # pages, by the name of their folder

    def bag(self, name: str) -> Path:
        """Return the path of a bag. Raises `InputError` if the folder contains no such bag."""
        path = (self.folder / name).resolve()
        if self.folder not in path.parents or not (path / METADATA_FILE).is_file():
            raise InputError(f"{name}: no such bag")
        return path

    def report(self, name: str) -> Path:
        """Return the path of a report's page. Raises `InputError` if `make_report` has not returned its name."""
        if name not in self._reports:
            raise InputError(f"{name}: no such report")
        return self._reports[name]

    async def rows(self) -> list[Row]:
        """Return all recorded runs, the newest first, each with the ``name`` of its bag.

        Raises `InputError` if the command that reads the bags fails.
        """
        if not any(self.folder.iterdir()):
            return []
        output = await _run(executable_command("worm_model", "bags"), str(self.folder), "--json")
        rows = json.loads(output)["runs"]
        for row in rows:
            row["name"] = str(Path(row["bag"]).resolve().relative_to(self.folder))
        return sorted(rows, key=lambda row: row["start"] or "", reverse=True)

    async def make_report(self, names: Sequence[str], parameter_file: str) -> str:
        """Make a report of bags, and return its name.

        Args:
            names: names of the bags.
            parameter_file: parameter file for the expected values; empty: the parameters in the recordings.
        """
        bags = [str(self.bag(name)) for name in names]
        folder = Path(mkdtemp(dir=self._temporary.name)) / "report"
        options = ["--parameters", parameter_file] if parameter_file else []
        options += ["--output", str(folder), "--without-front"]
        await _run(executable_command("worm_optimizer", "report"), *bags, *options)
        name = folder.parent.name
        self._reports[name] = folder / PAGE
        return name

    async def packed(self, name: str) -> Path:
        """Pack a bag into a ZIP file, and return the path of the file.

        Raises `InputError` if there is no such bag, or if it contains a link to a place outside the folder of bags.
        """
        bag = self.bag(name)
        if any(self.folder not in path.resolve().parents for path in bag.rglob("*")):
            raise InputError(f"{name}: links lead out of the bags folder")
        if self._packed is not None:
            shutil.rmtree(self._packed, ignore_errors=True)  # The previous download has been sent.
        self._packed = Path(mkdtemp(dir=self._temporary.name))
        made = self._packed / bag.name
        return Path(
            await asyncio.to_thread(shutil.make_archive, str(made), "zip", bag.parent, bag.name)
        )


async def _run(command: Sequence[str], *arguments: str) -> str:
    """Run a process with low priority, so that it does not delay the robot's nodes, and return its output."""
    process = await asyncio.create_subprocess_exec(
        "nice",
        *command,
        *arguments,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
    )
    output, errors = await process.communicate()
    if process.returncode:
        lines = errors.decode("utf-8", "replace").split("\n")
        last = next((line.strip() for line in reversed(lines) if line.strip()), "")
        raise InputError(last or f"{Path(command[-1]).name} failed")
    return output.decode("utf-8")


def cells_of(row: Row) -> dict[str, Any]:
    """Return the cells of a row in the list, by column."""
    row = {**row, "health": row["health"] or row["state"]}
    return {"name": row["name"], **{column.key: column.cell(row) for column in LISTED}}
