# SPDX-License-Identifier: Apache-2.0
"""A bag, whoever wrote it: rosbag2 directories and bare files, MCAP and what else rosbags can read."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple, Protocol

import yaml

from worm_model.bags.bag_errors import BagError
from worm_model.bags.blocks import MessageBlock
from worm_model.bags.payloads import Payloads

METADATA_FILE = "metadata.yaml"
METADATA_ROOT = "rosbag2_bagfile_information"
YAML_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # the one in C is ten times faster


@dataclass(frozen=True)
class Topic:
    """A topic of a bag.

    Attributes:
        name: full name.
        type_name: ``package/msg/Type``.
        count: number of messages.
        definition: text of the type with all that it needs, empty if the bag has none.
        definition_format: ``ros2msg`` or ``ros2idl``.
        encoding: of messages; only ``cdr`` can be decoded.
        metadata: of the channel: ``offered_qos_profiles`` (YAML) and ``topic_type_hash``.
    """

    name: str
    type_name: str
    count: int
    definition: str
    definition_format: str
    encoding: str
    metadata: tuple[tuple[str, str], ...] = ()


class Message(NamedTuple):
    """A message of a bag, undecoded. Times in ns since the epoch."""

    topic: str
    log_time: int
    data: bytes
    publish_time: int


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
    def topics(self) -> tuple[Topic, ...]:
        """Topics, by name."""
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

    def blocks(self, topics: frozenset[str]) -> Iterator[MessageBlock]:
        """Messages of some topics by rising log time, lazily."""
        ...

    def payloads(self, topics: frozenset[str]) -> dict[str, Payloads]:
        """All messages of some topics, by topic."""
        ...

    def close(self) -> None:
        """Close the files."""
        ...


class Bag:
    """A bag that is open for reading; a context manager.

    Args:
        path: directory or file that the bag was opened by.
        storage: the files behind it.
    """

    def __init__(self, path: Path, storage: Storage) -> None:
        self.path = path
        self._storage = storage
        self.topics = {topic.name: topic for topic in storage.topics}

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
            names = [block.names[index] for index in block.topic.tolist()]
            log_time, publish_time = block.log_time.tolist(), block.publish_time.tolist()
            yield from map(Message, names, log_time, block.payloads.messages(), publish_time)

    def blocks(self, topics: Iterable[str] | None = None) -> Iterator[MessageBlock]:
        """As `messages`, many at a time: each block begins no earlier than the one before it ends."""
        return self._storage.blocks(self._wanted(topics))

    def payloads(self, topics: Iterable[str]) -> dict[str, Payloads]:
        """All messages of some topics at once, by topic: fast, and as large as the topics are.

        Raises:
            BagError: as `messages`.
        """
        return self._storage.payloads(self._wanted(topics))

    def _wanted(self, topics: Iterable[str] | None) -> frozenset[str]:
        wanted = frozenset(self.topics if topics is None else topics)
        unknown = sorted(wanted - self.topics.keys())
        if unknown:
            raise BagError(
                f"{self.path} has no topic {unknown[0]}; it has {', '.join(sorted(self.topics))}"
            )
        return wanted


def read_metadata(directory: Path) -> dict[str, Any]:
    """Content of a bag's metadata.yaml below its root key.

    Raises:
        BagError: it is missing or not rosbag2's.
    """
    path = directory / METADATA_FILE
    try:
        document = yaml.load(path.read_text(encoding="utf-8"), Loader=YAML_LOADER)
    except FileNotFoundError:
        raise BagError(f"{path} is missing; worm_model recover {directory} makes one") from None
    except (OSError, UnicodeDecodeError, yaml.YAMLError, ValueError) as error:
        reason = " ".join(str(error).split())
        raise BagError(f"{path} cannot be read: {reason}") from None
    content = document.get(METADATA_ROOT) if isinstance(document, dict) else None
    files = content.get("relative_file_paths") if isinstance(content, dict) else None
    if (
        not isinstance(content, dict)
        or not isinstance(files, list)
        or not all(isinstance(name, str) for name in files)
    ):
        raise BagError(f"{path} is not rosbag2's: no {METADATA_ROOT} with relative_file_paths")
    return content
