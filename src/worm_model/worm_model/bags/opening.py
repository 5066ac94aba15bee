# SPDX-License-Identifier: Apache-2.0
"""Opening of bags. Reading never writes: what can be read of an unclosed or damaged bag is read, the rest reported."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path, PurePath

from worm_model.bags.formats.bag import Bag, Notify
from worm_model.bags.formats.bag_errors import BagError
from worm_model.bags.formats.bag_metadata import is_unfinished, read_metadata
from worm_model.bags.formats.finding import (
    COMPRESSED,
    METADATA_FILE,
    check_readable,
    is_storage,
)
from worm_model.bags.formats.mcap_file import McapFile
from worm_model.bags.formats.stored_file import LONGEST_GAP_NS, StoredFile

# metadata record of a recovered bag, with its source and what is missing
RECOVERY_RECORD = "worm_recovery"
SOURCE, LOSS = "recovered_from", "loss"
_log = logging.getLogger("worm_model.bags")


def open_bag(path: Path, notify: Notify = _log.warning, definitions: Path | None = None) -> Bag:
    """Open a bag for reading. The bag is not changed.

    Args:
        path: a rosbag2 directory, or one of its files (``.mcap``, ``.db3``).
        notify: called with one line for each file that is not complete, and for each inconsistency.
        definitions: folder of message definitions, see `Bag.define`.

    Raises:
        BagError: The bag is missing or of an unknown format, or none of its files can be read; or the definitions do
            not match its messages.
    """
    check_readable(path)
    if path.is_file():
        bag = Bag(path, [_open_file(path)], notify)
    else:
        bag = _open_folder(path, notify)
    try:
        if definitions is not None:
            bag.define(definitions)
    except BagError:
        bag.close()
        raise
    _report(bag)
    return bag


def _open_folder(path: Path, notify: Notify) -> Bag:
    files: list[StoredFile] = []
    errors: dict[str, BagError] = {}
    for name in _file_names(path, notify):
        try:
            files.append(_open_file(path / name))
        except BagError as error:
            errors[name] = error
    if errors and not files:
        raise next(reversed(errors.values()))
    return Bag(path, files, notify, [f"{name} is left out: {e}" for name, e in errors.items()])


def _file_names(path: Path, notify: Notify) -> Sequence[str]:
    """Return the names of a bag's files: of a closed bag as listed in its metadata.yaml, else of all in the folder."""
    present = sorted((e.name for e in path.iterdir() if is_storage(e.name)), key=_split_number)
    if not present and not (path / METADATA_FILE).exists():
        found = ", ".join(sorted(entry.name for entry in path.iterdir())) or "nothing"
        raise BagError(
            f"{path} is not a bag: it has neither {METADATA_FILE} nor a file *.mcap or *.db3 (found: {found})"
        )
    try:
        content = read_metadata(path)
    except BagError as error:
        if not present:
            raise
        notify(f"{error}; all files of the folder are read")
        return present
    if is_unfinished(content):
        return present
    listed = list(dict.fromkeys(PurePath(name).name for name in content["relative_file_paths"]))
    if surplus := sorted(set(present) - set(listed)):
        notify(f"{path}: {', '.join(surplus)} not read: not listed in {METADATA_FILE}")
    return listed


def _split_number(name: str) -> tuple[int, str]:
    """Return the sort key of a file of a split bag; the number counts, so that bag_2 precedes bag_10."""
    number = PurePath(name.removesuffix(COMPRESSED)).stem.rpartition("_")[2]
    return (int(number) if number.isdecimal() else 0), name


def _open_file(path: Path) -> StoredFile:
    if not path.name.removesuffix(COMPRESSED).endswith(".db3"):
        return McapFile(path)
    from worm_model.bags.formats.sqlite_file import SqliteFile  # here: rosbags.rosbag2 loads slowly

    return SqliteFile(path)


def _report(bag: Bag) -> None:
    """Report what is missing, and the inconsistencies of a bag."""
    for line in bag.damage:
        bag.notify(f"{bag.path}: {line}")
    for line in bag.remarks:
        bag.notify(f"{bag.path}: {line}")
    if recovery := bag.metadata.get(RECOVERY_RECORD):
        bag.notify(f"{bag.path} was recovered from {recovery.get(SOURCE)}: {recovery.get(LOSS)}")
    gaps = [(after[0] - before[1]) / 3.6e12 for before, after in pairwise(bag.spans)]
    if gaps:
        bag.notify(
            f"{bag.path}: its log times leave {len(gaps)} gaps of more than {LONGEST_GAP_NS / 3.6e12:g} h "
            f"({max(gaps):.1f} h the longest); durations and players skip them"
        )
    if bare := [c.name for c in bag.channels if c.count and c.type_name and not c.definition]:
        bag.notify(
            f"{bag.path} contains no definitions of {', '.join(bare)}; the installed definitions are used if type hash "
            "and length of the messages match"
        )
