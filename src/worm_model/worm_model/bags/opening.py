# SPDX-License-Identifier: Apache-2.0
"""Opening and reading of bags in any supported format.

Reading never writes: what can be read of an unclosed or damaged bag is read, the rest reported. The files of a bag are
read lazily, in parts (`stored_file.Extent`).
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import pairwise, zip_longest
from pathlib import Path, PurePath

import numpy as np

from worm_model.bags.formats.bag_errors import BagError
from worm_model.bags.formats.bag_metadata import is_unfinished, read_metadata
from worm_model.bags.formats.finding import METADATA_FILE, check_readable, is_storage
from worm_model.bags.formats.mcap_file import TOGETHER_BYTES, McapFile
from worm_model.bags.formats.message_block import Message, Messages, Topic, concatenate
from worm_model.bags.formats.stored_file import (
    LONGEST_GAP_NS,
    AttachedFile,
    StoredFile,
    joined_spans,
)

# metadata record of a recovered bag, with its source and what is missing
RECOVERY_RECORD = "worm_recovery"
SOURCE, LOSS = "recovered_from", "loss"
_log = logging.getLogger("worm_model.bags")

Notify = Callable[[str], None]


def open_bag(path: Path, notify: Notify = _log.warning) -> Bag:
    """Open a bag for reading. The bag is not changed.

    Args:
        path: a rosbag2 directory, or one of its files (``.mcap``, ``.db3``).
        notify: called with one line for each file that is not complete, and for each inconsistency.

    Raises:
        BagError: The bag is missing or of an unknown format, or none of its files can be read.
    """
    check_readable(path)
    names = [""] if path.is_file() else _file_names(path, notify)
    files: list[StoredFile] = []
    errors: dict[str, BagError] = {}
    for name in names:
        try:
            files.append(_open_file(path / name))
        except BagError as error:
            errors[name] = error
    if errors and not files:
        raise next(reversed(errors.values()))
    bag = Bag(path, files, notify, [f"{name} is left out: {e}" for name, e in errors.items()])
    _report(bag)
    return bag


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
    number = PurePath(name).stem.rpartition("_")[2]
    return (int(number) if number.isdecimal() else 0), name


def _open_file(path: Path) -> StoredFile:
    if path.suffix == ".zstd":
        raise BagError(
            f"{path} is compressed as a whole: decompress it (zstd -d) and open the file"
        )
    if path.suffix != ".db3":
        return McapFile(path)
    from worm_model.bags.formats.sqlite_file import SqliteFile  # here: rosbags.rosbag2 loads slowly

    return SqliteFile(path)


def _report(bag: Bag) -> None:
    """Report what is missing, and the inconsistencies of a bag."""
    for line in (*bag.damage, *bag.remarks):
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


# --- reading -------------------------------------------------------------------------------------


class Bag:
    """Bag that is open for reading; a context manager.

    Args:
        path: directory or file from which the bag was opened.
        files: the open files; closed with the bag.
        notify: called with one line for each inconsistency of the bag.
        damage: one line for each file of the bag that is missing or cannot be read.

    Attributes:
        channels: topics with their layouts; a topic whose layout changes occurs once for each layout.
        topics: topics by name. Each topic has its last layout, and its count includes the messages of all layouts.
        records: metadata records in the order of the files; identical records occur once.
        spans: first and last log time (ns since the epoch) of each part of the bag without a gap.
        damage: one line for each file that is not complete.
        remarks: one line for each inconsistency of a file.
    """

    def __init__(
        self,
        path: Path,
        files: Sequence[StoredFile],
        notify: Notify = lambda _: None,
        damage: Sequence[str] = (),
    ) -> None:
        self.path = path
        self.notify = notify
        self._files = files
        counts: Counter[Topic] = Counter()
        for file in files:
            for topic in file.channels.values():
                counts[topic] += topic.count
        by_name = sorted(counts.items(), key=lambda item: item[0].name)
        self.channels = tuple(replace(topic, count=count) for topic, count in by_name)
        self.topics = _by_name(self.channels)
        self.records = tuple(dict.fromkeys(r for file in files for r in file.metadata))
        self.spans = joined_spans(span for file in files for span in file.spans)
        self.damage = (*damage, *(f"{f.path.name}: {f.damage}" for f in files if f.damage))
        self.remarks = [f"{f.path.name}: {remark}" for f in files for remark in f.remarks]

    def close(self) -> None:
        """Close the files."""
        for file in self._files:
            file.close()

    def __enter__(self) -> Bag:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def start(self) -> int:
        """Smallest log time, ns since the epoch; 0 in an empty bag."""
        return self.spans[0][0] if self.spans else 0

    @property
    def duration_s(self) -> float:
        """Duration without gaps, s."""
        return sum(last - first for first, last in self.spans) * 1e-9

    def time_at(self, position_s: float) -> int:
        """Return the log time (ns) at a time since the start of the bag (s), which does not include gaps."""
        rest, time = round(position_s * 1e9), 0
        for first, last in self.spans:
            time = first + rest
            if time <= last:
                break
            rest -= last - first
        return time

    def position_at(self, log_time: int) -> float:
        """Return the time since the start of the bag at a log time (ns), s, without gaps."""
        passed = (min(log_time, last) - first for first, last in self.spans if log_time > first)
        return sum(passed) * 1e-9

    @property
    def message_count(self) -> int:
        """Number of messages."""
        return sum(topic.count for topic in self.topics.values())

    @property
    def metadata(self) -> dict[str, dict[str, str]]:
        """Last metadata record of each name, such as ``worm_run``; empty if the format has no metadata."""
        return {record.name: dict(record.values) for record in self.records}

    def attachments(self) -> Iterator[AttachedFile]:
        """Yield the files stored inside the bag, such as the parameter file of the run, each once."""
        return iter(dict.fromkeys(a for file in self._files for a in file.attachments))

    def messages(self, topics: Iterable[str] | None = None) -> Iterator[Message]:
        """Yield the messages in order of log time, lazily, so that memory does not grow with the bag.

        Args:
            topics: names of the topics to read; None: all.
        """
        for block in self.blocks(topics):
            yield from block

    def blocks(self, topics: Iterable[str] | None = None) -> Iterator[Messages]:
        """Yield the messages in blocks. One after the other, the blocks have the order of `messages`.

        However long the files are, memory holds only the extents that overlap in time, or those of about a megabyte.
        """
        wanted = frozenset(self.topics if topics is None else topics)
        unknown = sorted(wanted - self.topics.keys())
        if unknown:
            raise BagError(
                f"{self.path} has no topic {unknown[0]}; it has {', '.join(self.topics) or 'none'}"
            )
        files = self._files if wanted else ()
        extents = [(file, extent) for file in files for extent in file.extents]
        # Extents with equal times stay in the order of the files.
        extents.sort(key=lambda item: (item[1].start, item[1].end))
        pending: list[Messages] = []
        for (file, extent), following in zip_longest(extents, extents[1:]):
            pending.append(file.messages(extent, wanted))
            size = sum(len(block.buffer) for block in pending)
            if following is None or following[0] is not file or size >= TOGETHER_BYTES:
                block = concatenate(pending).sorted()
                ready = len(block)
                if following is not None:
                    ready = int(np.searchsorted(block.log_time, np.uint64(following[1].start)))
                if ready:
                    yield block.select(slice(ready))
                rest = block.select(slice(ready, None))
                pending = [rest.compact()] if len(rest) else []


def _by_name(channels: Iterable[Topic]) -> dict[str, Topic]:
    """Return the topics by name, each with its last layout and with the number of its messages in all layouts."""
    topics: dict[str, Topic] = {}
    for channel in channels:
        known = topics.get(channel.name)
        topics[channel.name] = replace(channel, count=channel.count + (known.count if known else 0))
    return topics
