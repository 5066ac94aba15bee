# SPDX-License-Identifier: Apache-2.0
"""Opens a bag, and recovers it first if it was not closed."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from pathlib import Path, PurePath
from typing import Any

from worm_model.bags.bag import Bag, Notify
from worm_model.bags.bag_errors import BagError, ExistsError, UnwritableError
from worm_model.bags.bag_metadata import custom_data, read_metadata
from worm_model.bags.finding import METADATA_FILE, recovered_path
from worm_model.bags.mcap_bag import McapBag, McapFile
from worm_model.bags.message_types import PACKAGE
from worm_model.bags.recorder import STATE, UNFINISHED
from worm_model.bags.recovery import (
    SOURCE,
    SOURCE_SHA256,
    fingerprint,
    mcap_files,
    named,
    open_files,
    recover,
    undeclared,
)
from worm_model.bags.rosbags_bag import RosbagsBag

_log = logging.getLogger("worm_model.bags")


def open_bag(path: Path, notify: Notify = _log.warning, definitions: Path | None = None) -> Bag:
    """Open a bag for reading.

    A bag that was not closed (killed recorder, full disk, power cut) or is spoilt is recovered into a new one beside
    it, which is opened instead; the old one is left as it is.

    Args:
        path: a rosbag2 directory, or one file of it (``.mcap``, ``.db3``).
        notify: told in one line when the bag had to be recovered, and what in it contradicts itself.
        definitions: as `Bag.define` takes it.

    Raises:
        BagError: it is missing, empty, foreign, damaged beyond recovery, or still being recorded; or the definitions
            do not fit.
    """
    if definitions is not None and not any(definitions.glob("*.msg")):
        raise BagError(
            f"{definitions} holds no .msg file; give the folder with those of {PACKAGE}, such as {PACKAGE}/msg"
        )
    bag = _open(path, notify)
    try:
        bag.define(definitions)
    except BagError:
        bag.close()
        raise
    return bag


def _open(path: Path, notify: Notify) -> Bag:
    if not path.exists():
        raise BagError(f"{path} does not exist")
    if path.is_file():
        if path.suffix == ".db3":
            return RosbagsBag(path, notify)
        return _open_mcap(path, [path], notify)
    if not (path / METADATA_FILE).exists():
        return _open_without_metadata(path, notify)
    content = read_metadata(path)
    files = _named_files(path, content)
    if content.get("storage_identifier") != "mcap" or content.get("compression_mode"):
        return _compared(RosbagsBag(path, notify), files)
    if is_unfinished(content):
        return _recovered(path, notify)
    return _compared(_open_mcap(path, files, notify), files)


def _open_without_metadata(path: Path, notify: Notify) -> Bag:
    if any(path.glob("*.mcap")):
        return _recovered(path, notify)
    content = ", ".join(sorted(entry.name for entry in path.iterdir())) or "nothing"
    raise BagError(
        f"{path} is not a bag: it has neither {METADATA_FILE} nor an MCAP file (found: {content})"
    )


def is_unfinished(content: Mapping[str, Any]) -> bool:
    """Whether a bag's metadata says that its recorder has not closed it."""
    return custom_data(content).get(STATE) == UNFINISHED


def _named_files(path: Path, content: dict[str, Any]) -> list[Path]:
    names = [PurePath(name).name for name in content["relative_file_paths"]]
    if not names:
        raise BagError(f"{path} names no files in its {METADATA_FILE}: nothing was recorded")
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise BagError(f"{path} names {twice[0]} twice in its {METADATA_FILE}; name it once")
    missing = [name for name in names if not (path / name).is_file()]
    if missing:
        raise BagError(f"{path} lacks {', '.join(missing)}, which its {METADATA_FILE} names")
    return [path / name for name in names]


def _compared(bag: Bag, files: Sequence[Path]) -> Bag:
    """The bag; a difference to what its metadata.yaml declares, the files among it, is told."""
    beside = sorted({file.name for file in bag.path.glob("*.mcap")} - {file.name for file in files})
    if beside and files[0].parent == bag.path:  # not where the bag had to be recovered
        bag.notify(f"{bag.path}: {', '.join(beside)} not read: {METADATA_FILE} names no such file")
    counts = {topic.name: topic.count for topic in bag.topics.values()}
    for topic, missing in undeclared(bag.path, counts):
        bag.notify(
            f"{bag.path}: {METADATA_FILE} tells of {counts.get(topic, 0) + missing} messages of {topic}, "
            f"the bag holds {counts.get(topic, 0)}"
        )
    return bag


def _open_mcap(path: Path, paths: Sequence[Path], notify: Notify) -> Bag:
    files, unreadable = open_files(paths)
    if _sound(files, unreadable):
        for file in files:
            for complaint in file.contents.complaints:
                notify(f"{file.path}: {complaint}")
        return McapBag(path, files, notify)
    _close(files)
    return _recovered(path, notify)


def _recovered(path: Path, notify: Notify) -> Bag:
    """The bag that an unclosed one was, or is now, recovered into."""
    path = named(path)
    content = _content(path)
    number = 1
    while (target := recovered_path(path, number)).exists():
        if _is_recovery(target, path, content):
            notify(f"{path} was not closed; reading {target}, into which it was recovered before")
            return _open(target, notify)
        number += 1
    try:
        report = recover(path, target)
    except ExistsError:
        return _recovered(path, notify)  # by another process, at the same time
    except UnwritableError as error:
        raise BagError(
            f"{path} was not closed, and {error}; "
            f"recover it elsewhere: worm_model recover {path} --output FOLDER"
        ) from None
    notify(f"{path} was not closed, or is spoilt; recovered {report}")
    return _open(target, notify)


def _content(path: Path) -> str:
    files, _ = open_files(mcap_files(path))
    content = fingerprint(files)
    _close(files)
    return content


def _is_recovery(target: Path, source: Path, content: str) -> bool:
    try:
        custom = custom_data(read_metadata(target))
    except BagError:
        return False
    return (custom.get(SOURCE), custom.get(SOURCE_SHA256)) == (source.name, content)


def _close(files: Sequence[McapFile]) -> None:
    for file in files:
        file.close()


def are_sound(paths: Sequence[Path]) -> bool:
    """Whether MCAP files can be read as they are."""
    files, unreadable = open_files(paths)
    sound = _sound(files, unreadable)
    _close(files)
    return sound


def _sound(files: Sequence[McapFile], unreadable: Sequence[object]) -> bool:
    return not unreadable and all(file.contents.sound for file in files)
