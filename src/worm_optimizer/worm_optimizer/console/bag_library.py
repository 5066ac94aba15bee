# SPDX-License-Identifier: Apache-2.0
"""Folder of the console's recordings, reports and parameter files. Pages can access files below this folder only."""

from __future__ import annotations

import asyncio
import hashlib
import json
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from worm_model.bags.formats.finding import METADATA_FILE
from worm_model.commands.bag_columns import COLUMNS
from worm_model.errors import InputError
from worm_optimizer.code_version import identity_of_all
from worm_optimizer.console.run_traces import RunTraces, traces_of
from worm_optimizer.operation.processes import executable_command
from worm_optimizer.report.report_page import PAGE, REPORT_SUFFIX, report_name

_LONGEST = 200  # largest number of characters of a name; longer names are cut
_IDENTIFIED = "identified_"  # prefix of the names of identified parameter files
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

        Raises:
            InputError: A bag is missing, or the report cannot be made.
        """
        bags = [self.bag(name) for name in names]
        digest = _digest([*(bag / METADATA_FILE for bag in bags), *_files(parameter_file)])
        folder = bags[0].with_name(
            report_name([*(b.name for b in bags[:-1]), f"{bags[-1].name}_{digest}"])
        )
        if not (folder / PAGE).is_file():
            arguments = [*map(str, bags), "--output", str(folder), "--without-front"]
            await _run(_report_command(), *arguments, *_options(parameter_file))
        return str(folder.relative_to(self.folder))

    async def traces(self, name: str, parameter_file: str) -> RunTraces:
        """Return the traces of a recorded run. Raises `InputError` if the bag is missing or cannot be read.

        Args:
            name: name of the bag.
            parameter_file: parameter file of the twin; empty: the parameters in the recording.
        """
        command = [sys.executable, "-m", traces_of.__module__]
        output = await _run(command, str(self.bag(name)), *_options(parameter_file))
        return RunTraces.from_json(name, output)

    async def identify(
        self, names: Sequence[str], parameter_file: str, progress: Callable[[str], None]
    ) -> str:
        """Identify parameters, make a report, and return the name of the new parameter file.

        Raises `InputError` if a bag is missing, or the identification or the report fails.

        Args:
            names: names of the bags.
            parameter_file: file with the known parameters; empty: the paper's values.
            progress: called with each line of progress.
        """
        bags = [str(self.bag(name)) for name in names]
        made = self.folder / time.strftime(f"{_IDENTIFIED}%Y_%m_%d-%H_%M_%S.yaml")
        with tempfile.TemporaryDirectory(prefix="worm_console_") as work:
            report = Path(work) / "identification"
            arguments = [*bags, *_options(parameter_file), "--output", str(made)]
            command = executable_command("worm_model", "identify")
            await _run(command, *arguments, "--report", str(report), progress=progress)
            progress("report")
            parts = ["--identification", str(made), "--identification", str(report)]
            arguments = [*bags, *_options(parameter_file), "--without-front", *parts]
            arguments += ["--output", str(self.folder / report_of(made.name))]
            await _run(_report_command(), *arguments, progress=progress)
        return made.name

    def identified(self) -> list[str]:
        """Return the names of all identified parameter files, the newest first."""
        return sorted(
            (path.name for path in self.folder.glob(f"{_IDENTIFIED}*.yaml")), reverse=True
        )

    def parameter_file(self, name: str) -> str:
        """Return the path of an identified parameter file. Raises `InputError` if there is no such file."""
        if name not in self.identified():
            raise InputError(f"{name}: no such parameter file")
        return str(self.folder / name)

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


def _report_command() -> list[str]:
    return executable_command("worm_optimizer", "report")


def _options(parameter_file: str) -> list[str]:
    return ["--parameters", parameter_file] if parameter_file else []


def _files(parameter_file: str) -> list[Path]:
    return [Path(parameter_file)] if parameter_file else []


def _digest(files: Sequence[Path]) -> str:
    """Return a short digest of files and of the code."""
    digest = hashlib.sha256(identity_of_all().encode())
    for path in files:
        digest.update(path.read_bytes())
    return digest.hexdigest()[:_DIGEST]


async def _run(
    command: Sequence[str], *arguments: str, progress: Callable[[str], None] = lambda _: None
) -> str:
    """Run a process with low priority, so that it does not delay the robot's nodes, and return its output.

    Args:
        command: the command.
        arguments: its arguments.
        progress: called with each line of its error output.

    Raises:
        InputError: The process failed. The message is the last line of its error output.
    """
    process = await asyncio.create_subprocess_exec(
        "nice",
        *command,
        *arguments,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
    )
    assert process.stdout is not None
    assert process.stderr is not None
    try:
        output, last = await asyncio.gather(
            process.stdout.read(), _report_lines(process.stderr, progress)
        )
        await process.wait()
    except asyncio.CancelledError:
        process.terminate()
        raise
    if process.returncode:
        raise InputError(last or f"{Path(command[-1]).name} failed")
    return output.decode("utf-8")


async def _report_lines(stream: asyncio.StreamReader, progress: Callable[[str], None]) -> str:
    """Report each line of a stream, and return the last one."""
    last = ""
    async for line in stream:
        if text := line.decode("utf-8", "replace").strip():
            last = text
            progress(text)
    return last


def report_of(parameter_file: str) -> str:
    """Return the name of the report that `BagLibrary.identify` makes together with a parameter file."""
    return report_name([Path(parameter_file).stem])


def cells_of(row: Row) -> dict[str, Any]:
    """Return the cells of a row in the list, by column."""
    row = {**row, "health": row["health"] or row["state"]}
    return {"name": row["name"], **{column.key: column.cell(row) for column in LISTED}}


def matches(row: Row, words: str) -> bool:
    """Return True if each of the words occurs in the cells, state, direction or notes of a row, ignoring case."""
    gait = row["gait"]
    direction = "" if gait is None else ("forward" if gait["direction"] > 0 else "reverse")
    shown = (*cells_of(row).values(), row["state"], direction, row.get("notes"))
    text = " ".join(map(str, filter(None, shown))).lower()
    return all(word in text for word in words.lower().split())
