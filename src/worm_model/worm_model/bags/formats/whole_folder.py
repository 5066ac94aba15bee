# SPDX-License-Identifier: Apache-2.0
"""Atomic creation of a folder: it appears complete or not at all, even after a power cut."""

from __future__ import annotations

import errno
import fcntl
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from worm_model.bags.formats.bag_errors import BagError, ExistsError
from worm_model.bags.formats.bag_metadata import sync_directory


@contextmanager
def new_folder(target: Path) -> Iterator[Path]:
    """Yield a temporary folder that is renamed to the target when the context ends, or removed after an exception.

    If a killed process left an unfinished folder for the same target, its content is removed first.

    Raises:
        ExistsError: The target exists, or another process has created it in the meantime.
        BagError: Another process is writing the target at this moment.
        OSError: The operating system cannot create or write the target.
    """
    if target.exists():
        raise ExistsError(f"{target} exists already and is not overwritten; choose another name")
    unfinished = target.with_name(f".{target.name}.unfinished")
    handle = _own(unfinished, target)
    try:
        _clear(unfinished)
        yield unfinished
        _synchronise(unfinished)
        _move(unfinished, target)
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)
        os.close(handle)


def _own(unfinished: Path, target: Path) -> int:
    """Create and lock the unfinished folder, and return its descriptor.

    The lock ends with the process, so that the folder of a dead process is not locked.
    """
    while True:
        unfinished.mkdir(parents=True, exist_ok=True)
        handle = os.open(unfinished, os.O_RDONLY | os.O_DIRECTORY)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(handle)
            raise BagError(
                f"{target} is being written by another process; wait until that has ended"
            ) from None
        with suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(handle), unfinished.stat()):
                return handle
        os.close(handle)  # between mkdir and lock, another process renamed the folder


def _clear(folder: Path) -> None:
    for entry in folder.iterdir():
        if entry.is_dir():
            shutil.rmtree(entry)
        else:
            entry.unlink()


def _synchronise(folder: Path) -> None:
    """Write files, subfolders and their names to the disk."""
    for entry in folder.iterdir():
        if entry.is_dir():
            _synchronise(entry)
            continue
        with entry.open("rb") as stream:
            os.fsync(stream.fileno())
    sync_directory(folder)


def _move(unfinished: Path, target: Path) -> None:
    try:
        unfinished.rename(target)  # replaces an empty folder, and fails if the folder has content
    except OSError as error:
        if error.errno not in (errno.ENOTEMPTY, errno.EEXIST, errno.ENOTDIR):
            raise
        raise ExistsError(
            f"{target} exists already: another process has created it; choose another name"
        ) from None
    sync_directory(target.parent)
