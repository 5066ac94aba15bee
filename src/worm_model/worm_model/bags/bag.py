# SPDX-License-Identifier: Apache-2.0
"""Abstract bag for reading, whatever its format: rosbag2 directories and single files, MCAP or other storages."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from worm_model.bags.bag_errors import BagError
from worm_model.bags.formats.cdr import check_length
from worm_model.bags.formats.message_block import Message, Messages, Topic
from worm_model.bags.formats.message_types import PACKAGE, with_definition

Notify = Callable[[str], None]


@dataclass(frozen=True)
class MetadataRecord:
    """Metadata record: text by key, under a name. Several records of a bag may have the same name."""

    name: str
    values: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class AttachedFile:
    """File stored inside a bag."""

    name: str
    media_type: str
    data: bytes


class Bag(ABC):
    """Bag that is open for reading; a context manager.

    Attributes:
        path: directory or file from which the bag was opened.
        channels: topics with their layouts; a topic whose layout changes occurs several times.
        start, end: smallest and largest log time, ns since the epoch; 0 in an empty bag.
        records: all metadata records in their order, without the repetitions in further files. A recording has one
            ``worm_gait`` for each gait that was run.
        notify: called with one line for each inconsistency of the bag.
        topics: topics by name, with the last layout and the number of messages of all layouts.
    """

    def __init__(
        self,
        path: Path,
        channels: tuple[Topic, ...],
        span: tuple[int, int],
        records: tuple[MetadataRecord, ...],
        notify: Notify,
    ) -> None:
        self.path = path
        self.channels = channels
        self.start, self.end = span
        self.records = records
        self.notify = notify
        self.topics = _by_name(channels)
        self._given: dict[Topic, Topic] = {}

    @abstractmethod
    def attachments(self) -> Iterator[AttachedFile]:
        """Yield the files stored inside the bag, such as the parameter file of the run."""

    @abstractmethod
    def _blocks(self, topics: frozenset[str]) -> Iterator[Messages]:
        """Yield the messages of some topics in order of log time, lazily."""

    @abstractmethod
    def close(self) -> None:
        """Close the files."""

    def define(self, definitions: Path | None) -> None:
        """Use external definitions for topics that contain none, and report these topics.

        Args:
            definitions: folder with the ``.msg`` files of worm_msgs from the time of the recording. None: the
                installed definitions are used later, for each topic that is decoded.

        Raises:
            BagError: A definition in the folder is incomplete, or its hash shows that it is another type.
        """
        bare = [c for c in self.channels if c.count and not c.definition]
        defined = [c for c in bare if definitions and _is_defined(c, definitions)]
        self._given = {channel: with_definition(channel, definitions) for channel in defined}
        self.channels = tuple(self._given.get(channel, channel) for channel in self.channels)
        self.topics = _by_name(self.channels)
        self._tell(defined, f"those in {definitions} are taken")
        rest = [c for c in bare if c not in defined]
        self._tell(
            rest, "the installed ones are taken, if type hash and length of the messages allow it"
        )
        if definitions and not defined:
            self.notify(f"{self.path} has no use for {definitions}: {_why_useless(bare)}")

    def _tell(self, channels: Sequence[Topic], what: str) -> None:
        if channels:
            names = ", ".join(channel.name for channel in channels)
            self.notify(f"{self.path}: {names} carry no definition; {what}")

    def __enter__(self) -> Bag:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def message_count(self) -> int:
        """Number of messages."""
        return sum(topic.count for topic in self.topics.values())

    @property
    def metadata(self) -> dict[str, dict[str, str]]:
        """Metadata by name, such as ``worm_run``, the last record of each; empty if the format has none."""
        return {record.name: dict(record.values) for record in self.records}

    def messages(self, topics: Iterable[str] | None = None) -> Iterator[Message]:
        """Yield the messages in order of log time, lazily, so that memory does not grow with the bag.

        Args:
            topics: names of the topics to read; None: all.

        Raises:
            BagError: A topic does not exist, or the file is damaged.
        """
        for block in self.blocks(topics):
            yield from block

    def blocks(self, topics: Iterable[str] | None = None) -> Iterator[Messages]:
        """Yield the messages in blocks, like `messages`. Each block begins no earlier than the previous one ends."""
        wanted = frozenset(self.topics if topics is None else topics)
        unknown = sorted(wanted - self.topics.keys())
        if unknown:
            raise BagError(
                f"{self.path} has no topic {unknown[0]}; it has {', '.join(self.topics) or 'none'}"
            )
        blocks = self._blocks(wanted) if wanted else iter(())
        return map(self._defined, blocks) if self._given else blocks

    def _defined(self, block: Messages) -> Messages:
        """Return the messages with the external definitions. Raises BagError if these do not fit."""
        taken = np.array([channel in self._given for channel in block.channels], bool)
        channels = tuple(self._given.get(channel, channel) for channel in block.channels)
        defined = replace(block, channels=channels)
        for message in defined.select(taken[block.channel]) if taken.any() else ():
            check_length(message.channel, message.data)
        return defined


def _by_name(channels: Iterable[Topic]) -> dict[str, Topic]:
    """Return the topics by name, with the last layout and the number of messages of all layouts."""
    topics: dict[str, Topic] = {}
    for channel in sorted(channels, key=lambda c: c.name):
        known = topics.get(channel.name)
        count = channel.count + (known.count if known else 0)
        topics[channel.name] = replace(channel, count=count)
    return topics


def _is_defined(channel: Topic, definitions: Path) -> bool:
    """Return True if a folder of worm_msgs' definitions contains that of a topic."""
    package, _, kind = channel.type_name.partition("/msg/")
    return package == PACKAGE and (definitions / f"{kind}.msg").is_file()


def _why_useless(bare: Sequence[Topic]) -> str:
    if not bare:
        return "its topics carry their definitions"
    return f"it has none of {', '.join(sorted({channel.type_name for channel in bare}))}"
