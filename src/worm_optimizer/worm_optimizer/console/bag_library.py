# SPDX-License-Identifier: Apache-2.0
"""Folder of the console's recordings and reports. Pages can access files below this folder only."""

from __future__ import annotations

import asyncio
import hashlib
import json
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from worm_model.bags.formats.finding import METADATA_FILE
from worm_model.commands.bag_columns import COLUMNS
from worm_model.errors import InputError
from worm_optimizer.code_version import code_identity
from worm_optimizer.operation.processes import executable_command
from worm_optimizer.report.report_page import PAGE, REPORT_SUFFIX, report_name

_LONGEST = 200  # largest number of characters of a name; longer names are cut
_DIGEST = 8  # number of characters of a digest in a name
LISTED = tuple(column for column in COLUMNS if column.label)  # columns of the list of recordings

Row = dict[str, Any]


class BagLibrary:
    """Folder of bags, which is created if it is missing."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.folder = folder.resolve()

    def bag(self, name: str) -> Path:
        """Return the path of a bag. Raises `InputError` if the folder contains no such bag."""
        path = self._below(name)
        if not (path / METADATA_FILE).is_file():
            raise InputError(f"{name}: no such bag")
        return path

    def report(self, name: str) -> Path:
        """Return the path of a report's page. Raises `InputError` if the folder contains no such report."""
        path = self._below(name)
        if not (path.name.endswith(REPORT_SUFFIX) and (path / PAGE).is_file()):
            raise InputError(f"{name}: no such report")
        return path / PAGE

    def _below(self, name: str) -> Path:
        try:
            path = (self.folder / name[:_LONGEST]).resolve()
        except (OSError, ValueError):
            path = self.folder
        if self.folder not in path.parents:
            raise InputError(f"{name}: not in the bags folder")
        return path

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
        """Make a report of bags unless it exists, and return its name.

        The name contains a digest of the bags' metadata, the parameter file and the code. A change of one of these
        therefore results in a new report.

        Args:
            names: names of the bags.
            parameter_file: parameter file for the expected values; empty: the parameters in the recordings.
        """
        bags = [self.bag(name) for name in names]
        stated = [parameter_file] if parameter_file else []
        digest = _digest([*(bag / METADATA_FILE for bag in bags), *map(Path, stated)])
        folder = bags[0].with_name(
            report_name([*(b.name for b in bags[:-1]), f"{bags[-1].name}_{digest}"])
        )
        if not (folder / PAGE).is_file():
            options = [part for file in stated for part in ("--parameters", file)]
            options += ["--output", str(folder), "--without-front"]
            await _run(executable_command("worm_optimizer", "report"), *map(str, bags), *options)
        return str(folder.relative_to(self.folder))

    async def packed(self, name: str, folder: Path) -> Path:
        """Pack a bag into a ZIP file in another folder and return the path of the file.

        Raises `InputError` if there is no such bag, or if it contains a link to a place outside the folder of bags.
        """
        bag = self.bag(name)
        if any(self.folder not in path.resolve().parents for path in bag.rglob("*")):
            raise InputError(f"{name}: links lead out of the bags folder")
        made = await asyncio.to_thread(
            shutil.make_archive, str(folder / bag.name), "zip", bag.parent, bag.name
        )
        return Path(made)


def _digest(files: Sequence[Path]) -> str:
    """Return a short digest of files and of the code."""
    digest = hashlib.sha256(code_identity().encode())
    for path in files:
        digest.update(path.read_bytes())
    return digest.hexdigest()[:_DIGEST]


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
