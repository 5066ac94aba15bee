# SPDX-License-Identifier: Apache-2.0
"""A bag, whoever wrote it: rosbag2 directories and bare files, MCAP and what else rosbags can read."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Protocol

from worm_model.bags.bag_errors import BagError
from worm_model.bags.bag_metadata import METADATA_FILE as METADATA_FILE
from worm_model.bags.message_block import Message, Messages, Topic

Notify = Callable[[str], None]
_log = logging.getLogger("worm_model.bags")


@dataclass(frozen=True)
class MetadataRecord:
    """Text by key, under a name that several records of a bag may share."""

    name: str
    values: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class AttachedFile:
    """A file that is kept inside a bag."""

    name: str
    media_type: str
    data: bytes


class Storage(Protocol):
    """What a bag needs of the files that it lies in."""

    @property
    def channels(self) -> tuple[Topic, ...]:
        """Topics with their layouts; one whose layout changes occurs several times."""
        ...

    @property
    def span(self) -> tuple[int, int]:
        """Least and greatest log time, ns; (0, 0) without messages."""
        ...

    @property
    def records(self) -> tuple[MetadataRecord, ...]:
        """Metadata records in their order, those that several files repeat once."""
        ...

    def attachments(self) -> Iterator[AttachedFile]:
        """Files kept inside."""
        ...

    def blocks(self, topics: frozenset[str]) -> Iterator[Messages]:
        """Messages of some topics by rising log time, lazily."""
        ...

    def close(self) -> None:
        """Close the files."""
        ...


class Bag:
    """A bag that is open for reading; a context manager.

    Args:
        path: directory or file that the bag was opened by.
        storage: the files behind it.
        notify: told in one line what is odd about the bag.

    Attributes:
        channels: topics with their layouts.
        topics: by name, with the layout that was last and the messages of all.
    """

    def __init__(self, path: Path, storage: Storage, notify: Notify = _log.warning) -> None:
        self.path = path
        self.notify = notify
        self._storage = storage
        self.channels = storage.channels
        self.topics: dict[str, Topic] = {}
        for channel in sorted(self.channels, key=lambda c: c.name):
            known = self.topics.get(channel.name)
            count = channel.count + (known.count if known else 0)
            self.topics[channel.name] = replace(channel, count=count)
        bare = [c.name for c in self.channels if c.count and not c.definition]
        if bare:
            notify(
                f"{path}: {', '.join(bare)} carry no definition; the installed ones are taken, "
                "if type hash and length of the messages allow it"
            )

    def __enter__(self) -> Bag:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the bag."""
        self._storage.close()

    @property
    def start(self) -> int:
        """Least log time, ns since the epoch; 0 in an empty bag."""
        return self._storage.span[0]

    @property
    def end(self) -> int:
        """Greatest log time, ns since the epoch; 0 in an empty bag."""
        return self._storage.span[1]

    @property
    def message_count(self) -> int:
        """Number of messages."""
        return sum(topic.count for topic in self.topics.values())

    @property
    def metadata(self) -> dict[str, dict[str, str]]:
        """Metadata by name, such as ``worm_run``, the last record of each; empty where the format has none."""
        return {record.name: dict(record.values) for record in self.records}

    @property
    def records(self) -> tuple[MetadataRecord, ...]:
        """All metadata records in their order: a recording has one ``worm_gait`` for each gait that was run."""
        return self._storage.records

    def attachments(self) -> Iterator[AttachedFile]:
        """Files kept inside the bag, such as the parameter file of the run."""
        return self._storage.attachments()

    def messages(self, topics: Iterable[str] | None = None) -> Iterator[Message]:
        """Messages by rising log time, lazily: memory does not grow with the bag.

        Args:
            topics: only these; None: all.

        Raises:
            BagError: a topic does not exist, or the file turns out to be damaged.
        """
        for block in self.blocks(topics):
            yield from block

    def blocks(self, topics: Iterable[str] | None = None) -> Iterator[Messages]:
        """As `messages`, many at a time: each block begins no earlier than the one before it ends."""
        wanted = frozenset(self.topics if topics is None else topics)
        unknown = sorted(wanted - self.topics.keys())
        if unknown:
            raise BagError(
                f"{self.path} has no topic {unknown[0]}; it has {', '.join(self.topics) or 'none'}"
            )
        return self._storage.blocks(wanted) if wanted else iter(())
