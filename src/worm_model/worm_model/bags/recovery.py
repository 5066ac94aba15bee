# SPDX-License-Identifier: Apache-2.0
"""Makes a whole bag of one whose recorder was killed, whose disk was full, or that was cut off."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from worm_model.bags.bag import METADATA_FILE, read_metadata
from worm_model.bags.bag_errors import BagError
from worm_model.bags.bag_writer import ROSBAG2_RECORD, BagWriter
from worm_model.bags.mcap_contents import read_contents, scan_contents
from worm_model.bags.mcap_file import McapFile, Reader
from worm_model.bags.mcap_storage import McapStorage

SOURCE = "recovered_from"
SOURCE_BYTES = "recovered_bytes"


@dataclass(frozen=True)
class Recovery:
    """What was saved.

    Attributes:
        bag: the new bag.
        messages: number of messages in it.
        lost_bytes: bytes at the ends of the files that are not part of anything whole.
        damaged_chunks: spoilt chunks in between, left out.
        unreadable: files of the old bag that hold nothing.
    """

    bag: Path
    messages: int
    lost_bytes: int
    damaged_chunks: int
    unreadable: tuple[str, ...]

    def __str__(self) -> str:
        parts = [f"{self.messages} messages"]
        if self.lost_bytes:
            parts.append(f"{self.lost_bytes} bytes at the end were not whole")
        if self.damaged_chunks:
            parts.append(f"{self.damaged_chunks} chunks were spoilt")
        if self.unreadable:
            parts.append(f"nothing was in {', '.join(self.unreadable)}")
        return f"{self.bag}: {'; '.join(parts)}"


def recover(path: Path, output: Path | None = None) -> Recovery:
    """Write what is whole of a bag to a new one.

    Args:
        path: a bag directory, whatever is left of it, or an MCAP file.
        output: the new bag, which must not exist; None: ``<path>_recovered`` beside the old one.

    Raises:
        BagError: there is nothing to save, the bag is still being recorded, or the output exists.
    """
    files, unreadable = open_files(mcap_files(path), scan_contents)
    try:
        for file in files:
            if not file.contents.whole and file.is_being_written():
                raise BagError(f"{path} is still being recorded; stop the recorder first")
        target = path.with_name(f"{path.stem}_recovered") if output is None else output
        messages = _rewrite(files, target, path)
    finally:
        for file in files:
            file.close()
    return Recovery(
        bag=target,
        messages=messages,
        lost_bytes=sum(file.size - file.contents.end for file in files if not file.contents.whole),
        damaged_chunks=sum(file.contents.damaged_chunks for file in files),
        unreadable=unreadable,
    )


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
    found = [path / name for name in dict.fromkeys(named + beside) if (path / name).is_file()]
    if not found:
        raise BagError(f"{path} holds no MCAP file: nothing can be recovered")
    return found


def _split_number(name: str) -> tuple[int, str]:
    """Order of the files of a split bag: bag_2 before bag_10."""
    number = Path(name).stem.rpartition("_")[2]
    return (int(number) if number.isdecimal() else 0), name


def open_files(
    paths: Iterable[Path], read: Reader = read_contents
) -> tuple[list[McapFile], tuple[str, ...]]:
    """Open what can be opened; also the names of those that cannot.

    Raises:
        BagError: none can.
    """
    files: list[McapFile] = []
    failed: list[str] = []
    reason: BagError | None = None
    for path in paths:
        try:
            files.append(McapFile(path, read))
        except BagError as error:
            failed.append(path.name)
            reason = error
    if reason is not None and not files:
        raise reason
    return files, tuple(failed)


def total_size(files: Sequence[McapFile]) -> int:
    """Size of the files in bytes, by which a recovery is recognised later."""
    return sum(file.size for file in files)


def _rewrite(files: Sequence[McapFile], target: Path, source: Path) -> int:
    storage = McapStorage(files)
    custom = {SOURCE: source.name, SOURCE_BYTES: str(total_size(files))}
    count = 0
    with BagWriter(target, custom) as writer:
        for attached in storage.attachments():
            writer.add_attachment(attached)
        for record in storage.records:
            if record.name != ROSBAG2_RECORD:
                writer.add_metadata(record.name, dict(record.values))
        for topic in storage.topics:
            writer.add_topic(topic)
        for block in storage.blocks(frozenset(topic.name for topic in storage.topics)):
            writer.write_block(block)
            count += len(block)
    return count
