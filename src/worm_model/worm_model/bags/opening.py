# SPDX-License-Identifier: Apache-2.0
"""Opening of bags. Bags that were not closed or are damaged are recovered first."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path, PurePath
from typing import Any

from worm_model.bags.formats.bag import Bag, Notify
from worm_model.bags.formats.bag_errors import RECOVER, BagError, ExistsError, UnwritableError
from worm_model.bags.formats.bag_metadata import custom_data, read_metadata
from worm_model.bags.formats.finding import (
    METADATA_FILE,
    check_readable,
    is_storage,
    recovered_path,
)
from worm_model.bags.formats.message_types import PACKAGE
from worm_model.bags.formats.stored_file import StoredFile
from worm_model.bags.recovery.recovery import (
    LOSS,
    RECOVERY_RECORD,
    SOURCE,
    SOURCE_SHA256,
    fingerprint,
    is_unfinished,
    named,
    open_files,
    recover,
    undeclared,
)
from worm_model.errors import printable

_log = logging.getLogger("worm_model.bags")


def open_bag(path: Path, notify: Notify = _log.warning, definitions: Path | None = None) -> Bag:
    """Open a bag for reading.

    A bag that was not closed (killed recorder, full disk, power cut) or is damaged is recovered into a new bag next
    to it. The new bag is opened instead; the old one is not changed.

    Args:
        path: a rosbag2 directory, or one of its files (``.mcap``, ``.db3``).
        notify: called with one line if the bag was recovered or is inconsistent.
        definitions: folder of message definitions, see `Bag.define`.

    Raises:
        BagError: The bag is missing, empty, of an unknown format, damaged beyond recovery, or still being recorded; or
            the definitions do not match its messages.
    """
    if definitions is not None and not any(definitions.glob("*.msg")):
        raise BagError(
            f"{definitions} holds no .msg file; give the folder with the .msg files of {PACKAGE}, such as {PACKAGE}/msg"
        )
    bag = _open(path, notify)
    try:
        bag.define(definitions)
    except BagError:
        bag.close()
        raise
    return bag


def _open(path: Path, notify: Notify) -> Bag:
    bag = _open_as_it_is(path, notify)
    if bag.path == path and (recovery := bag.metadata.get(RECOVERY_RECORD)):
        notify(f"{path} was recovered from {recovery.get(SOURCE)}: {recovery.get(LOSS)}")
    return bag


def _open_as_it_is(path: Path, notify: Notify) -> Bag:
    check_readable(path)
    if path.is_file():
        return _open_stored(path, [path], notify)
    if not (path / METADATA_FILE).exists():
        return _open_without_metadata(path, notify)
    content = read_metadata(path)
    files = _named_files(path, content)
    if is_unfinished(content):
        return _recovered(path, notify)
    return _compared(_open_stored(path, files, notify), files)


def _open_without_metadata(path: Path, notify: Notify) -> Bag:
    if any(is_storage(entry.name) for entry in path.iterdir()):
        return _recovered(path, notify)
    content = ", ".join(sorted(entry.name for entry in path.iterdir())) or "nothing"
    raise BagError(
        f"{path} is not a bag: it has neither {METADATA_FILE} nor a file *.mcap or *.db3 (found: {content})"
    )


def is_unclosed(path: Path) -> bool:
    """Return True if a folder is a bag that its recorder has not closed."""
    try:
        return is_unfinished(read_metadata(path))
    except BagError:
        return any(path.glob("*.mcap"))  # killed before its metadata.yaml was written


def _named_files(path: Path, content: dict[str, Any]) -> list[Path]:
    names = [PurePath(name).name for name in content["relative_file_paths"]]
    if not names:
        raise BagError(f"{path} names no files in its {METADATA_FILE}: nothing was recorded")
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise BagError(f"{path} names {twice[0]} twice in its {METADATA_FILE}; name it once")
    missing = [name for name in names if not (path / name).is_file()]
    if missing:
        raise BagError(
            f"{path} lacks {', '.join(missing)}, which its {METADATA_FILE} names; save the other files with: "
            f"{RECOVER} {path}"
        )
    return [path / name for name in names]


def _compared(bag: Bag, files: Sequence[Path]) -> Bag:
    """Return the bag; report files and messages that differ from its metadata.yaml."""
    unlisted = sorted(
        {file.name for file in bag.path.glob("*.mcap")} - {file.name for file in files}
    )
    if unlisted and files[0].parent == bag.path:  # not if a recovered copy is open
        bag.notify(f"{bag.path}: {', '.join(unlisted)} not read: not listed in {METADATA_FILE}")
    counts = {topic.name: topic.count for topic in bag.topics.values()}
    for topic, missing in undeclared(bag.path, counts).items():
        bag.notify(
            f"{bag.path}: {METADATA_FILE} declares {counts.get(topic, 0) + missing} messages of {topic}, "
            f"the bag holds {counts.get(topic, 0)}"
        )
    return bag


def _open_stored(path: Path, paths: Sequence[Path], notify: Notify) -> Bag:
    files = _sound_files(paths)
    if files is None:
        return _recovered(path, notify)
    for file in files:
        for complaint in file.contents.complaints:
            notify(f"{file.path}: {complaint}")
    return Bag(path, files, notify)


def _sound_files(paths: Sequence[Path]) -> list[StoredFile] | None:
    """Return the open files of a bag; None if one of them requires recovery."""
    files, unreadable = open_files(paths)
    if not unreadable and all(file.contents.sound for file in files):
        return files
    _close(files)
    return None


def _recovered(path: Path, notify: Notify) -> Bag:
    """Return the recovered copy of an unclosed or damaged bag; recover the bag if there is none."""
    path = named(path)
    content = fingerprint(path)
    number = 1
    while (target := recovered_path(path, number)).exists():
        if _is_recovery(target, path, content):
            return _instead(path, target, notify, "an earlier recovery is read")
        number += 1
    try:
        report = recover(path, target)
    except ExistsError:
        return _recovered(path, notify)  # another process has recovered the bag at the same time
    except UnwritableError as error:
        raise BagError(
            f"{path} was not closed, or is damaged, and {error}; "
            f"recover it elsewhere: {RECOVER} {path} --output FOLDER"
        ) from None
    return _instead(path, target, notify, f"{report.messages} messages were recovered")


def _instead(path: Path, target: Path, notify: Notify, outcome: str) -> Bag:
    """Return the recovered copy of a bag; report the recovery and the loss that the copy records, in one line."""
    lines = [f"{path} was not closed, or is damaged: {outcome} ({target})"]
    bag = _open_as_it_is(target, lines.append)
    if recovery := bag.metadata.get(RECOVERY_RECORD):
        lines.append(recovery.get(LOSS, ""))
    notify("; ".join(lines))
    bag.notify = notify
    return bag


def _is_recovery(target: Path, source: Path, content: str) -> bool:
    try:
        custom = custom_data(read_metadata(target))
    except BagError:
        return False
    return (custom.get(SOURCE), custom.get(SOURCE_SHA256)) == (printable(source.name), content)


def _close(files: Sequence[StoredFile]) -> None:
    for file in files:
        file.close()


def are_sound(paths: Sequence[Path]) -> bool:
    """Return True if the files of a bag can be read without recovery."""
    files = _sound_files(paths)
    _close(files or ())
    return files is not None
