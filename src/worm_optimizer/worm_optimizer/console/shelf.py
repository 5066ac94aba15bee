# SPDX-License-Identifier: Apache-2.0
"""The bags folder as pages see it: names below it and nothing else; what is done with bags is the commands' work."""

from __future__ import annotations

import asyncio
import json
import shutil
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from worm_model.bags.finding import METADATA_FILE
from worm_model.errors import InputError
from worm_optimizer.operation.processes import executable_command
from worm_optimizer.report.report_page import PAGE

_LONGEST = 200  # characters of a name that a file system takes in any case
REPORT = "_report"  # ends the name of a report's folder
_IDENTIFIED = "identified_"  # begins the name of a parameter file that was made here

Row = dict[str, Any]


class Shelf:
    """A folder of bags, made if it is not there."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.folder = folder.resolve()

    def bag(self, name: str) -> Path:
        """The bag of a name; raises `InputError` unless it is one below the folder."""
        path = self._below(name)
        if not (path / METADATA_FILE).is_file():
            raise InputError(f"{name}: no such bag")
        return path

    def report(self, name: str) -> Path:
        """The page of a report; raises `InputError` unless there is one below the folder."""
        path = self._below(name)
        if not (path.name.endswith(REPORT) and (path / PAGE).is_file()):
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
        """All recorded runs, the newest first, each with the ``name`` of its bag. Raises `InputError`."""
        if not any(self.folder.iterdir()):
            return []
        output = await _run("worm_model", "bags", str(self.folder), "--json")
        rows = json.loads(output)["runs"]
        for row in rows:
            row["name"] = str(Path(row["bag"]).resolve().relative_to(self.folder))
        return sorted(rows, key=lambda row: row["start"] or "", reverse=True)

    async def make_report(self, names: Sequence[str]) -> str:
        """The name of the report of bags, made if it is not there yet. Raises `InputError`."""
        bags = [self.bag(name) for name in names]
        folder = bags[0].with_name("_with_".join(bag.name for bag in bags) + REPORT)
        if not (folder / PAGE).is_file():
            words = [*map(str, bags), "--output", str(folder), "--without-front"]
            await _run("worm_optimizer", "report", *words)
        return str(folder.relative_to(self.folder))

    async def identify(
        self, names: Sequence[str], parameters: str, tell: Callable[[str], None]
    ) -> str:
        """The name of the parameter file that bags give, its report beside it. Raises `InputError`.

        ``parameters`` is the file of what is known already, empty for the paper's; ``tell`` hears how far it is.
        """
        bags = [str(self.bag(name)) for name in names]
        made = self.folder / time.strftime(f"{_IDENTIFIED}%Y_%m_%d-%H_%M_%S.yaml")
        parameter_words = ["--parameters", parameters] if parameters else []
        with tempfile.TemporaryDirectory(prefix="worm_console_") as work:
            report = Path(work) / "identification"
            words = [*bags, *parameter_words, "--output", str(made), "--report", str(report)]
            await _run("worm_model", "identify", *words, tell=tell)
            tell("report")
            parts = ["--identification", str(made), "--identification", str(report)]
            words = [*bags, *parameter_words, "--without-front", *parts]
            words += ["--output", str(self.folder / report_of(made.name))]
            await _run("worm_optimizer", "report", *words, tell=tell)
        return made.name

    def identified(self) -> list[str]:
        """The names of all parameter files that were made here, the newest first."""
        return sorted(
            (path.name for path in self.folder.glob(f"{_IDENTIFIED}*.yaml")), reverse=True
        )

    def parameter_file(self, name: str) -> str:
        """The path of one of them. Raises `InputError`."""
        if name not in self.identified():
            raise InputError(f"{name}: no such parameter file")
        return str(self.folder / name)

    async def packed(self, name: str, folder: Path) -> Path:
        """A bag as one file, in a folder of one's own. Raises `InputError`."""
        bag = self.bag(name)
        if any(self.folder not in path.resolve().parents for path in bag.rglob("*")):
            raise InputError(f"{name}: links lead out of the bags folder")
        made = await asyncio.to_thread(
            shutil.make_archive, str(folder / bag.name), "zip", bag.parent, bag.name
        )
        return Path(made)


async def _run(
    package: str, executable: str, *words: str, tell: Callable[[str], None] = lambda _: None
) -> str:
    """The output of an executable; a process of its own, and a nice one, so that nothing else waits.

    ``tell`` hears each line of its error output. Raises `InputError` with the last one where it fails.
    """
    process = await asyncio.create_subprocess_exec(
        "nice",
        *executable_command(package, executable),
        *words,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
    )
    assert process.stdout is not None
    assert process.stderr is not None
    try:
        output, last = await asyncio.gather(process.stdout.read(), _heard(process.stderr, tell))
        await process.wait()
    except asyncio.CancelledError:
        process.terminate()
        raise
    if process.returncode:
        raise InputError(last or f"{executable} failed")
    return output.decode("utf-8")


async def _heard(stream: asyncio.StreamReader, tell: Callable[[str], None]) -> str:
    """Tells each line of a stream as it comes; the last one."""
    last = ""
    async for line in stream:
        if text := line.decode("utf-8", "replace").strip():
            last = text
            tell(text)
    return last


def report_of(parameter_file: str) -> str:
    """The name of the report that is made with a parameter file."""
    return Path(parameter_file).stem + REPORT


def found(rows: Sequence[Row], words: str) -> list[Row]:
    """The rows in which each word occurs: in the name, the date, the gait's direction, the health or the notes."""
    wanted = words.lower().split()
    return [row for row in rows if all(word in _text(row) for word in wanted)]


def _text(row: Row) -> str:
    gait = row["gait"]
    way = "" if gait is None else ("forward" if gait["direction"] > 0 else "reverse")
    parts = (row["name"], row["start"], way, row["health"], row["state"], row.get("notes"))
    return " ".join(str(part) for part in parts if part).lower()
