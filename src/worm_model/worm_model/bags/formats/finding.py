# SPDX-License-Identifier: Apache-2.0
"""Names of bags, and search for the bags below a folder."""

from __future__ import annotations

import os
import re
import stat
import time
from pathlib import Path

from worm_model.bags.formats.bag_errors import BagError
from worm_model.errors import InputError, printable

METADATA_FILE = "metadata.yaml"
STORAGE = (".mcap", ".db3")
TIME_FIELD = "{time}"  # placeholder in a bag's name for the time at which its recording begins


def check_readable(path: Path) -> None:
    """Raise `BagError` unless a path is a file or a folder. Opening a named pipe would block forever."""
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        raise BagError(f"{path} does not exist; give the folder or the file of a bag") from None
    except OSError as error:  # loop of symbolic links, or no permission
        raise BagError(f"{path} cannot be opened: {error.strerror}") from None
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        raise BagError(f"{path} is neither a file nor a folder; give the folder or file of a bag")
    if not os.access(path, os.R_OK):
        raise BagError(f"{path} cannot be read: permission denied")


def dated(output: Path) -> Path:
    """Return the path of a recording that begins now: `TIME_FIELD` is replaced by the local time."""
    return Path(str(output).replace(TIME_FIELD, time.strftime("%Y_%m_%d-%H_%M_%S")))


def is_storage(name: str) -> bool:
    """Return True if a file name has the ending of a file of a bag."""
    return name.endswith(STORAGE)


def recovered_path(bag: Path) -> Path:
    """Return the path of a bag's recovered copy.

    Only the ending ``.mcap`` is removed from the name: the copy of ``pipe_0.25Hz`` is ``pipe_0.25Hz_recovered``.
    """
    return bag.with_name(f"{bag.stem if bag.suffix == '.mcap' else bag.name}_recovered")


def bags_below(folder: Path) -> list[Path]:
    """Return all bags below a folder, sorted by path.

    A bag is a folder with a metadata.yaml, a folder that a killed recorder left without metadata.yaml, or a single
    ``.mcap`` or ``.db3`` file in any other folder. Without metadata.yaml, a folder is a bag if each of its ``.mcap``
    and ``.db3`` files is named after the folder, with a number appended. If ``folder`` itself is a bag, it is the only
    result. Raises `InputError` if there is no bag.
    """
    check_readable(folder)
    bags = [folder] if folder.is_file() else _walked(folder)
    if not bags:
        raise InputError(
            f"{folder}: holds no bag (a folder with {METADATA_FILE}, or a file *.mcap, *.db3); record one (./worm demo)"
        )
    return bags


def name_below(folder: Path, bag: Path) -> str:
    """Return the path of a bag relative to a folder, as text; the bag's name if the folder itself is the bag."""
    return str(bag.relative_to(folder)) if bag != folder else bag.name


def mark_of(bag: Path) -> str:
    """Return a text that changes when the bag changes: names, sizes and modification times of its files."""
    files = [bag] if bag.is_file() else sorted(file for file in bag.iterdir() if file.is_file())
    stats = [(file.name, file.stat()) for file in files]
    return " ".join(f"{name}:{stat.st_size}:{stat.st_mtime_ns}" for name, stat in stats)


def _walked(folder: Path) -> list[Path]:
    bags: list[Path] = []
    for place, inner, names in os.walk(folder):
        path = Path(place)
        files = [f for name in names if is_storage(name) and (f := path / name).is_file()]
        split = re.compile(rf"{re.escape(printable(path.resolve().name))}_\d+\.\w+")
        if METADATA_FILE in names or (files and all(split.fullmatch(f.name) for f in files)):
            bags.append(path)
            inner.clear()
        else:
            bags += files
    return sorted(bags)
