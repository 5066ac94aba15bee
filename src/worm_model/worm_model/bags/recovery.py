# SPDX-License-Identifier: Apache-2.0
"""Makes a whole bag of one whose recorder was killed, whose disk was full, or that was cut off or spoilt."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from worm_model.bags.bag import Bag
from worm_model.bags.bag_errors import BagError, DefinitionError
from worm_model.bags.bag_metadata import (
    declared_counts,
    read_metadata,
    silent_topics,
)
from worm_model.bags.bag_writer import new_bag
from worm_model.bags.finding import METADATA_FILE, recovered_path
from worm_model.bags.mcap_bag import McapBag, McapFile, explained
from worm_model.bags.mcap_scan import verify
from worm_model.bags.message_block import Topic
from worm_model.bags.message_types import with_definition

SOURCE = "recovered_from"
SOURCE_SHA256 = "recovered_sha256"


@dataclass(frozen=True)
class LostMessages:
    """Messages that a bag once held and a recovery did not save.

    Attributes:
        file: name of the file that they were in.
        start, end: log times between which they were, ns since the epoch; `end` 0: until the end.
        size: bytes that are spoilt.
        counts: messages by topic; None where nothing tells.
    """

    file: str
    start: int
    end: int
    size: int
    counts: dict[str, int] | None

    def __str__(self) -> str:
        counts = self.counts
        if counts is None:
            what = "an unknown number of messages"
        elif not counts:
            what = "no messages"
        else:
            what = ", ".join(f"{count} of {topic}" for topic, count in sorted(counts.items()))
        until = f"to {self.end * 1e-9:.3f} s" if self.end else "on"
        return f"{self.file}: {self.size} bytes spoilt, lost from {self.start * 1e-9:.3f} s {until}: {what}"


@dataclass(frozen=True)
class Recovery:
    """What was saved.

    Attributes:
        bag: the new bag.
        messages: number of messages in it.
        lost_bytes: bytes at the ends of the files that are not part of anything whole.
        unreadable: files of the old bag that hold nothing.
        lost: the spoilt parts in between, left out, and what they held.
        undeclared: difference between the numbers of messages in metadata.yaml and in the new bag, by topic.
        complaints: in what the summary of a file contradicted its data.
    """

    bag: Path
    messages: int
    lost_bytes: int
    unreadable: tuple[str, ...]
    lost: tuple[LostMessages, ...] = ()
    undeclared: tuple[tuple[str, int], ...] = ()
    complaints: tuple[str, ...] = ()

    def __str__(self) -> str:
        parts = [f"{self.messages} messages"]
        if self.lost_bytes:
            parts.append(f"{self.lost_bytes} bytes at the end were not whole")
        if self.unreadable:
            parts.append(f"nothing was in {', '.join(self.unreadable)}")
        parts += [*map(str, self.lost), *self.complaints]
        for topic, missing in self.undeclared:
            more = "more" if missing > 0 else "fewer"
            parts.append(f"metadata.yaml tells of {abs(missing)} {more} of {topic}")
        return f"{self.bag}: {'; '.join(parts)}"


def recover(path: Path, output: Path | None = None) -> Recovery:
    """Write what is whole of a bag to a new one.

    Args:
        path: a bag directory, whatever is left of it, or an MCAP file.
        output: the new bag, which must not exist; None: ``<path>_recovered`` beside the old one.

    Raises:
        BagError: there is nothing to save, the bag is still being recorded, or the output exists.
    """
    path = named(path)
    files, unreadable = open_files(mcap_files(path))
    try:
        for file in files:
            if not file.contents.whole and file.is_being_written():
                raise BagError(f"{path} is still being recorded; stop the recorder first")
            with explained(file.path):
                verify(file.data, file.contents)
        target = recovered_path(path) if output is None else output
        bag = McapBag(path, files)
        custom = {SOURCE: path.name, SOURCE_SHA256: fingerprint(files)}
        with new_bag(target, custom) as writer:
            writer.copy_records(bag)
            for channel in bag.channels:
                writer.add_topic(channel)
            for topic in _silent_topics(path, bag):
                writer.add_topic(topic)
            messages = writer.write_all(bag.messages())
        whole = [file for file in files if file.contents.whole]
        return Recovery(
            bag=target,
            messages=messages,
            lost_bytes=sum(f.size - f.contents.end for f in files if f not in whole),
            unreadable=unreadable,
            lost=tuple(loss for file in files for loss in _losses(file)),
            undeclared=undeclared(path, {t.name: t.count for t in bag.topics.values()}),
            complaints=tuple(f"{f.path.name}: {c}" for f in files for c in f.contents.complaints),
        )
    finally:
        for file in files:
            file.close()


def _silent_topics(path: Path, bag: Bag) -> Iterable[Topic]:
    """Topics without messages: the data of a file need not name them, its metadata.yaml does."""
    with suppress(BagError):  # without metadata.yaml nothing tells of them
        for topic in silent_topics(read_metadata(path)) if path.is_dir() else ():
            if topic.name not in bag.topics:
                with suppress(DefinitionError):  # not installed, or another one
                    topic = with_definition(topic)
                yield topic


def named(path: Path) -> Path:
    """The path with a name to its last part, which ``.`` and ``..`` are not."""
    return path.resolve() if path.name in ("", "..") else path


def _losses(file: McapFile) -> Iterable[LostMessages]:
    channels = file.channels
    for loss in sorted(file.contents.losses):
        counts: Counter[str] = Counter()
        for number, count in (loss.counts or {}).items():
            counts[channels[number].name if number in channels else f"channel {number}"] += count
        after = [e.start for e in file.contents.extents if e.start > loss.start]
        end = loss.end or min(after, default=0)
        plain = None if loss.counts is None else dict(counts)
        yield LostMessages(file.path.name, loss.start, end, loss.size, plain)


def undeclared(path: Path, counts: dict[str, int]) -> tuple[tuple[str, int], ...]:
    """By how much a closed bag's metadata.yaml tells of more messages than there are, by topic, where it does."""
    try:
        declared = declared_counts(read_metadata(path)) if path.is_dir() else {}
    except BagError:
        return ()
    if not sum(declared.values()):  # of a bag that was not closed
        return ()
    names = sorted(declared.keys() | counts.keys())
    differences = [(name, declared.get(name, 0) - counts.get(name, 0)) for name in names]
    return tuple((name, difference) for name, difference in differences if difference)


def mcap_files(path: Path) -> list[Path]:
    """MCAP files of a bag in their order: those that metadata.yaml names, and those beside it.

    Raises:
        BagError: there are none.
    """
    if path.is_file():
        return [path]
    if not path.is_dir():
        raise BagError(f"{path} does not exist")
    named: list[str] = []
    if (path / METADATA_FILE).exists():
        try:
            named = [Path(name).name for name in read_metadata(path)["relative_file_paths"]]
        except BagError:
            named = []  # a spoilt metadata.yaml: the files tell
    beside = sorted((p.name for p in path.glob("*.mcap")), key=_split_number)
    files = [path / name for name in dict.fromkeys(named + beside) if (path / name).is_file()]
    if not files:
        raise BagError(f"{path} holds no MCAP file: nothing can be recovered")
    return files


def _split_number(name: str) -> tuple[int, str]:
    """Order of the files of a split bag: bag_2 before bag_10."""
    number = Path(name).stem.rpartition("_")[2]
    return (int(number) if number.isdecimal() else 0), name


def open_files(paths: Iterable[Path]) -> tuple[list[McapFile], tuple[str, ...]]:
    """Open what can be opened; also the names of those that cannot.

    Raises:
        BagError: none can.
    """
    files: list[McapFile] = []
    failed: list[str] = []
    reason: BagError | None = None
    for path in paths:
        try:
            files.append(McapFile(path))
        except BagError as error:
            failed.append(path.name)
            reason = error
    if reason is not None and not files:
        raise reason
    return files, tuple(failed)


def fingerprint(files: Sequence[McapFile]) -> str:
    """SHA-256 of the files' content, by which a recovery is recognised later."""
    digest = hashlib.sha256()
    for file in files:
        digest.update(file.data)
    return digest.hexdigest()
