# SPDX-License-Identifier: Apache-2.0
"""Which bags there are below a folder, and which of them were recovered from another, by their names."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from pathlib import Path

from worm_model.errors import InputError

METADATA_FILE = "metadata.yaml"
STORAGE = (".mcap", ".db3")
_COPY = re.compile(r"(?P<source>.+)_recovered(?:_(?P<number>\d+))?")


def recovered_path(bag: Path, number: int = 1) -> Path:
    """Where a bag is recovered to; ``pipe_0.25Hz`` and ``pipe_0.30Hz`` do not meet."""
    return bag.with_name(f"{_plain(bag)}_recovered{'' if number == 1 else f'_{number}'}")


def bags_below(folder: Path) -> dict[Path, list[Path]]:
    """All bags below a folder, or the one that it is, by name, each with what was recovered from it, the last one last.

    A bag is a folder with a metadata.yaml, a folder with files that are named after it, as a killed recorder leaves
    them, or a file by itself. Raises `InputError` if there is none.
    """
    if not folder.exists():
        raise InputError(f"{folder}: does not exist; name a folder that holds bags, or a bag")
    bags = [folder] if folder.is_file() else _walked(folder)
    if not bags:
        raise InputError(
            f"{folder}: holds no bag (a folder with {METADATA_FILE}, or a file *.mcap, *.db3); record one (./worm demo)"
        )
    return _with_copies(bags)


def name_below(folder: Path, bag: Path) -> str:
    """What a bag is called in a table of a folder's bags, or of the one bag that the folder is."""
    return str(bag.relative_to(folder)) if bag != folder else bag.name


def mark_of(bag: Path) -> str:
    """What tells that a bag is the one of before: names, sizes and times of its files."""
    files = [bag] if bag.is_file() else sorted(file for file in bag.iterdir() if file.is_file())
    stats = [(file.name, file.stat()) for file in files]
    return " ".join(f"{name}:{stat.st_size}:{stat.st_mtime_ns}" for name, stat in stats)


def _walked(folder: Path) -> list[Path]:
    bags: list[Path] = []
    for place, inner, names in os.walk(folder):
        path = Path(place)
        files = [path / name for name in names if name.endswith(STORAGE)]
        split = re.compile(rf"{re.escape(path.resolve().name)}_\d+\.\w+")
        if METADATA_FILE in names or (files and all(split.fullmatch(f.name) for f in files)):
            bags.append(path)
            inner.clear()
        else:
            bags += files
    return sorted(bags)


def _with_copies(bags: Sequence[Path]) -> dict[Path, list[Path]]:
    sources = {(bag.parent, _plain(bag)): bag for bag in bags}
    copies: list[tuple[int, Path, Path]] = []
    for bag in bags:
        match = _COPY.fullmatch(bag.name)
        if match and (source := sources.get((bag.parent, match["source"]))):
            copies.append((int(match["number"] or 1), source, bag))
    source_of = {copy: source for _, source, copy in copies}
    copies_of: dict[Path, list[Path]] = {bag: [] for bag in bags if bag not in source_of}
    for _, source, copy in sorted(copies):
        while source in source_of:  # a copy that was recovered in its turn
            source = source_of[source]
        copies_of[source].append(copy)
    return copies_of


def _plain(bag: Path) -> str:
    return bag.stem if bag.suffix == ".mcap" else bag.name
