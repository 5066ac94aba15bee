# SPDX-License-Identifier: Apache-2.0
"""Opens a bag, and recovers it first if it was not closed."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from pathlib import Path, PurePath
from typing import Any

from worm_model.bags.bag import METADATA_FILE, Bag, read_metadata
from worm_model.bags.bag_errors import BagError, ExistsError, UnwritableError
from worm_model.bags.mcap_file import McapFile
from worm_model.bags.mcap_storage import McapStorage
from worm_model.bags.recovery import (
    SOURCE,
    SOURCE_BYTES,
    mcap_files,
    open_files,
    recover,
    total_size,
)
from worm_model.bags.rosbags_storage import RosbagsStorage

UNFINISHED = "being recorded"  # state that the recorder's provisional metadata.yaml declares

Notify = Callable[[str], None]
_log = logging.getLogger("worm_model.bags")


def open_bag(path: Path, notify: Notify = _log.warning) -> Bag:
    """Open a bag for reading.

    A bag that was not closed (killed recorder, full disk, power cut) is recovered into a new one beside it, which is
    opened instead; the old one is left as it is.

    Args:
        path: a rosbag2 directory, or one file of it (``.mcap``, ``.db3``).
        notify: told in one line when the bag had to be recovered.

    Raises:
        BagError: it is missing, empty, foreign, damaged beyond recovery, or still being recorded.
    """
    if not path.exists():
        raise BagError(f"{path} does not exist")
    if path.is_file():
        return (
            Bag(path, RosbagsStorage(path))
            if path.suffix == ".db3"
            else _open_mcap(path, [path], notify)
        )
    if not (path / METADATA_FILE).exists():
        return _open_without_metadata(path, notify)
    content = read_metadata(path)
    if content.get("storage_identifier") != "mcap" or content.get("compression_mode"):
        return Bag(path, RosbagsStorage(path))
    if _is_unfinished(content):
        return _recovered(path, notify)
    return _open_mcap(path, _named_files(path, content), notify)


def _open_without_metadata(path: Path, notify: Notify) -> Bag:
    if any(path.glob("*.mcap")):
        return _recovered(path, notify)
    found = ", ".join(sorted(entry.name for entry in path.iterdir())) or "nothing"
    raise BagError(
        f"{path} is not a bag: it has neither {METADATA_FILE} nor an MCAP file (found: {found})"
    )


def _is_unfinished(content: dict[str, Any]) -> bool:
    custom = content.get("custom_data")
    return isinstance(custom, dict) and custom.get("state") == UNFINISHED


def _named_files(path: Path, content: dict[str, Any]) -> list[Path]:
    files = [path / PurePath(name).name for name in content["relative_file_paths"]]
    missing = [file.name for file in files if not file.is_file()]
    if missing:
        raise BagError(f"{path} lacks {', '.join(missing)}, which its {METADATA_FILE} names")
    if not files:
        raise BagError(f"{path} names no files in its {METADATA_FILE}: nothing was recorded")
    return files


def _open_mcap(path: Path, paths: Sequence[Path], notify: Notify) -> Bag:
    files, unreadable = open_files(paths)
    if not unreadable and all(file.contents.sound for file in files):
        try:
            return Bag(path, McapStorage(files))
        except BagError:
            _close(files)
            raise
    _close(files)
    return _recovered(path, notify)


def _recovered(path: Path, notify: Notify) -> Bag:
    """The bag that an unclosed one was, or is now, recovered into."""
    size = _size(path)
    target = path.with_name(f"{path.stem}_recovered")
    number = 1
    while target.exists():
        if _is_recovery(target, path, size):
            notify(f"{path} was not closed; reading {target}, into which it was recovered before")
            return open_bag(target, notify)
        number += 1
        target = path.with_name(f"{path.stem}_recovered_{number}")
    try:
        report = recover(path, target)
    except ExistsError:
        return _recovered(path, notify)  # by another process, at the same time
    except UnwritableError as error:
        raise BagError(
            f"{path} was not closed, and {error}; "
            f"recover it elsewhere: worm_model recover {path} --output FOLDER"
        ) from None
    notify(f"{path} was not closed; recovered {report}")
    return open_bag(target, notify)


def _size(path: Path) -> int:
    files, _ = open_files(mcap_files(path))
    size = total_size(files)
    _close(files)
    return size


def _is_recovery(target: Path, source: Path, size: int) -> bool:
    try:
        custom = read_metadata(target).get("custom_data")
    except BagError:
        return False
    return isinstance(custom, dict) and (custom.get(SOURCE), custom.get(SOURCE_BYTES)) == (
        source.name,
        str(size),
    )


def _close(files: Sequence[McapFile]) -> None:
    for file in files:
        file.close()
