# SPDX-License-Identifier: Apache-2.0
"""Recovery of bags whose recorder was killed, whose disk was full, or that were cut off or damaged."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from worm_model.bags.formats.bag import Bag
from worm_model.bags.formats.bag_errors import BagError, DefinitionError
from worm_model.bags.formats.bag_metadata import (
    STATE,
    UNFINISHED,
    custom_data,
    declared_counts,
    read_metadata,
    silent_topics,
)
from worm_model.bags.formats.bag_writer import new_bag
from worm_model.bags.formats.finding import COMPRESSED, check_readable, is_storage, recovered_path
from worm_model.bags.formats.mcap_file import McapFile, SalvagedMcapFile
from worm_model.bags.formats.mcap_records import MAGIC as MCAP_MAGIC
from worm_model.bags.formats.message_block import Topic
from worm_model.bags.formats.message_types import with_definition
from worm_model.bags.formats.sqlite_file import MAGIC as SQLITE_MAGIC
from worm_model.bags.formats.sqlite_file import SqliteFile
from worm_model.bags.formats.stored_file import StoredFile
from worm_model.checksum import sha256_of
from worm_model.errors import printable

SOURCE = "recovered_from"
SOURCE_SHA256 = "recovered_sha256"
# metadata record of a recovered bag, with its source and its loss
RECOVERY_RECORD = "worm_recovery"
LOSS = "loss"
_LISTED = 3  # number of damaged parts of a file that are described individually
_NUMBERED = re.compile(r"(?P<stem>.+_)(?P<number>\d+)(?P<ending>\.(?:mcap|db3)(?:\.zstd)?)")


@dataclass(frozen=True)
class DamagedFile:
    """Damage of a file.

    Attributes:
        file: its name.
        unit: unit in which ``parts`` counts: bytes, or rows of the file's table.
        parts: for each damaged part, its first and last place (exclusive), and the span of log time in which messages
            may be missing (s since the start of the bag). A bound that is None is unknown.
        is_closed: True if the file ends like a closed file.
        cut_off: number of bytes at the end of the file that are not part of a complete record.
        missing: number of missing messages by topic; None if neither the summary nor an index of the file contains this
            number.
        contradictions: inconsistencies within the file.
    """

    file: str
    unit: str
    parts: tuple[tuple[int, int, float | None, float | None], ...]
    is_closed: bool
    cut_off: int
    missing: Mapping[str, int] | None
    contradictions: tuple[str, ...]

    def __str__(self) -> str:
        texts = []
        for first, last, start, end in self.parts[:_LISTED]:
            since = "from its start" if start is None else f"from {start:.3f} s"
            until = "to its end" if end is None else f"to {end:.3f} s"
            texts.append(f"{self.unit} {first} to {last} are damaged (recorded {since} {until})")
        if len(self.parts) > _LISTED:
            texts.append(f"{len(self.parts) - _LISTED} further parts are damaged")
        if self.cut_off:
            texts.append(f"it is cut off: its last {self.cut_off} bytes are not a whole record")
        elif not self.is_closed:
            texts.append("it was not closed: it ends without an index")
        if self.missing is None:
            texts.append("an unknown number of messages is missing")
        elif self.missing:
            counts = ", ".join(f"{n} of {topic}" for topic, n in sorted(self.missing.items()))
            texts.append(f"{sum(self.missing.values())} messages are missing ({counts})")
        elif self.parts:
            texts.append("no message is missing")
        return f"{self.file}: {'; '.join([*texts, *self.contradictions])}"


@dataclass(frozen=True)
class Recovery:
    """Outcome of a recovery.

    Attributes:
        bag: the new bag.
        messages: number of messages in it.
        damaged: files of the old bag that are damaged or inconsistent.
        unreadable: reasons why files of the old bag could not be read, by name.
        absent: names of missing files, according to metadata.yaml or to gaps in the numbers of the present files.
        undeclared: number of messages declared by metadata.yaml minus the number found, by topic, if they differ.
    """

    bag: Path
    messages: int
    damaged: tuple[DamagedFile, ...] = ()
    unreadable: Mapping[str, str] | None = None
    absent: tuple[str, ...] = ()
    undeclared: Mapping[str, int] | None = None

    @property
    def loss(self) -> str:
        """Known loss in one line; empty if there is none."""
        parts = [*map(str, self.damaged), *(self.unreadable or {}).values()]
        if self.absent:
            parts.append(f"files missing with all their messages: {', '.join(self.absent)}")
        counted: Counter[str] = Counter()
        for file in self.damaged:
            counted.update(file.missing or {})
        for topic, difference in (self.undeclared or {}).items():
            if difference != counted[topic]:
                more = "more" if difference > 0 else "fewer"
                parts.append(
                    f"metadata.yaml declares {abs(difference)} {more} messages of {topic} than were found"
                )
        return "; ".join(parts)

    def __str__(self) -> str:
        return f"{self.bag}: {self.messages} messages" + (f"; {self.loss}" if self.loss else "")


def recover(path: Path, output: Path | None = None) -> Recovery:
    """Write the intact data of a bag to a new one.

    Args:
        path: a bag directory, also an incomplete one, or a file of a bag.
        output: the new bag, which must not exist; None: ``<path>_recovered`` next to the old one.

    Raises:
        BagError: No file of the bag can be read, the bag is still being recorded, or the output exists.
        UnwritableError: The operating system cannot create or write the output.
    """
    path = named(path)
    files, unreadable = open_files(storage_files(path), SalvagedMcapFile)
    try:
        for file in files:
            if not file.contents.whole and file.is_being_written():
                raise BagError(f"{path} is still being recorded; stop the recorder first")
        source = printable(path.name)
        target = recovered_path(path) if output is None else output
        bag = Bag(path, files)
        counts = {topic.name: topic.count for topic in bag.topics.values()}
        damaged = tuple(d for file in files if (d := _damage(file, bag.start)) is not None)
        report = Recovery(
            bag=target,
            messages=bag.message_count,
            damaged=damaged,
            unreadable=unreadable,
            absent=_absent(path),
            undeclared=undeclared(path, counts),
        )
        with new_bag(target, {SOURCE: source, SOURCE_SHA256: fingerprint(path)}) as writer:
            writer.copy_records(bag)
            if report.loss:
                writer.add_metadata(RECOVERY_RECORD, {SOURCE: source, LOSS: printable(report.loss)})
            for channel in bag.channels:
                writer.add_topic(channel)
            for topic in _silent_topics(path, bag):
                writer.add_topic(topic)
            writer.write_all(bag.messages())
        return report
    finally:
        for file in files:
            file.close()


def _damage(file: StoredFile, origin: int) -> DamagedFile | None:
    contents = file.contents
    if contents.sound and not contents.complaints:
        return None
    cut_off = 0
    parts: list[tuple[int, int, float | None, float | None]] = []
    for loss in contents.losses:
        if not contents.whole and contents.unit == "bytes" and loss.last == len(file.data):
            cut_off = loss.last - loss.first
        else:
            start, end = ((t - origin) * 1e-9 if t else None for t in contents.span_around(loss))
            parts.append((loss.first, loss.last, start, end))
    missing: Counter[str] = Counter()
    for number, count in contents.missing().items():
        channel = file.channels.get(number)
        missing[channel.name if channel else f"channel {number}"] += count
    counted = contents.expected is not None or (
        contents.complete and all(loss.counts for loss in contents.losses)
    )
    return DamagedFile(
        file=file.path.name,
        unit=contents.unit,
        parts=tuple(parts),
        is_closed=contents.whole,
        cut_off=cut_off,
        missing=dict(missing) if counted else None,
        contradictions=tuple(contents.complaints),
    )


def _silent_topics(path: Path, bag: Bag) -> Iterable[Topic]:
    """Yield the topics without messages, which metadata.yaml lists but the files may not."""
    with suppress(BagError):  # without metadata.yaml these topics are unknown
        for topic in silent_topics(read_metadata(path)) if path.is_dir() else ():
            if topic.name not in bag.topics:
                with suppress(DefinitionError):  # definition not installed, or of another version
                    topic = with_definition(topic)
                yield topic


def named(path: Path) -> Path:
    """Return a path that ends in a name: the resolved path if the given one is ``.`` or ends in ``..``."""
    return path.resolve() if path.name in ("", "..") else path


def is_unfinished(content: Mapping[str, Any]) -> bool:
    """Return True if a bag's metadata shows that its recorder has not closed it."""
    return custom_data(content).get(STATE) == UNFINISHED


def undeclared(path: Path, counts: Mapping[str, int]) -> dict[str, int]:
    """Return the number of messages that a bag's metadata.yaml declares minus the number in ``counts``, by topic.

    Topics without a difference are omitted. The result is empty if the bag is a single file, is not closed,
    or declares no messages.
    """
    try:
        content = read_metadata(path) if path.is_dir() else {}
    except BagError:
        return {}
    declared = declared_counts(content)
    if is_unfinished(content) or not sum(declared.values()):
        return {}
    differences = {
        name: declared.get(name, 0) - counts.get(name, 0)
        for name in declared.keys() | counts.keys()
    }
    return {name: difference for name, difference in sorted(differences.items()) if difference}


def storage_files(path: Path) -> list[Path]:
    """Return the files of a bag: first the files that metadata.yaml lists, then the other files in the folder.

    Raises:
        BagError: There are no such files.
    """
    check_readable(path)
    if path.is_file():
        return [path]
    present = [entry.name for entry in path.iterdir() if is_storage(entry.name)]
    names = dict.fromkeys([*_named_files(path), *sorted(present, key=_split_number)])
    files = [path / name for name in names if (path / name).is_file()]
    if not files:
        raise BagError(f"{path} holds no file *.mcap or *.db3: nothing can be recovered")
    return files


def _named_files(path: Path) -> list[str]:
    try:
        return [Path(name).name for name in read_metadata(path)["relative_file_paths"]]
    except BagError:
        return []  # metadata.yaml is missing or damaged; only the files count


def _absent(path: Path) -> tuple[str, ...]:
    """Return names of missing files, according to metadata.yaml and to gaps in the numbers of the present files."""
    if path.is_file():
        return ()
    there = {file.name: file for file in storage_files(path)}
    expected = dict.fromkeys(_named_files(path))
    matches = [match for name in there if (match := _NUMBERED.fullmatch(name))]
    for match in matches:
        others = (int(m["number"]) for m in matches if m["stem"] == match["stem"])
        if int(match["number"]) == max(others) < 10_000:  # a larger number is implausible
            expected |= {
                f"{match['stem']}{n}{match['ending']}": None for n in range(int(match["number"]))
            }
    return tuple(sorted(expected.keys() - there.keys(), key=_split_number))


def _split_number(name: str) -> tuple[int, str]:
    """Return the sort key of a file of a split bag; the number counts, so that bag_2 precedes bag_10."""
    number = Path(name.removesuffix(COMPRESSED)).stem.rpartition("_")[2]
    return (int(number) if number.isdecimal() else 0), name


def _is_sqlite(path: Path) -> bool:
    check_readable(path)
    with path.open("rb") as stream:
        beginning = stream.read(len(SQLITE_MAGIC))
    return beginning == SQLITE_MAGIC or (
        path.name.removesuffix(COMPRESSED).endswith(".db3") and not beginning.startswith(MCAP_MAGIC)
    )


def open_files(
    paths: Iterable[Path], mcap_file: type[McapFile] = McapFile
) -> tuple[list[StoredFile], dict[str, str]]:
    """Open the files that can be opened; return them, and the errors of the other files by name.

    Args:
        paths: the files.
        mcap_file: class that reads MCAP files.

    Raises:
        BagError: No file can be opened.
    """
    files: list[StoredFile] = []
    failed: dict[str, BagError] = {}
    for path in paths:
        try:
            files.append(SqliteFile(path) if _is_sqlite(path) else mcap_file(path))
        except BagError as error:
            failed[path.name] = error
    if failed and not files:
        raise next(reversed(failed.values()))
    return files, {name: str(error) for name, error in failed.items()}


def fingerprint(path: Path) -> str:
    """Return the SHA-256 of the content of a bag's files, which identifies the source of a recovery later."""
    return sha256_of(storage_files(path))
