# SPDX-License-Identifier: Apache-2.0
"""A bag that lies in one or several MCAP files."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import groupby
from operator import itemgetter

from worm_model.bags.bag import AttachedFile, MetadataRecord, Topic
from worm_model.bags.bag_errors import BagError
from worm_model.bags.blocks import MessageBlock, merge
from worm_model.bags.mcap_file import McapFile
from worm_model.bags.payloads import Payloads, join


class McapStorage:
    """Reads MCAP files as one.

    Args:
        files: the open files; closed with the storage.

    Raises:
        BagError: the files contradict each other.
    """

    def __init__(self, files: Sequence[McapFile]) -> None:
        self._files = files
        self.topics = _topics(files)
        self.span = _span(files)
        records = (record for file in files for record in file.contents.metadata)
        self.records = tuple(
            dict.fromkeys(
                MetadataRecord(record.name, tuple(record.metadata.items())) for record in records
            )
        )

    def close(self) -> None:
        """Close the files."""
        for file in self._files:
            file.close()

    def attachments(self) -> Iterator[AttachedFile]:
        """Files kept inside, each once even if every MCAP file repeats it."""
        seen = set()
        for file in self._files:
            for record in file.attachments():
                attached = AttachedFile(record.name, record.media_type, record.data)
                if attached not in seen:
                    seen.add(attached)
                    yield attached

    def payloads(self, topics: frozenset[str]) -> dict[str, Payloads]:
        """All messages of some topics, by topic."""
        parts: dict[str, list[Payloads]] = {topic: [] for topic in topics}
        for file in self._files:
            for topic, payloads in file.payloads(tuple(sorted(topics))):
                parts[topic].append(payloads)
        return {topic: join(found) for topic, found in parts.items()}

    def blocks(self, topics: frozenset[str]) -> Iterator[MessageBlock]:
        """Messages of some topics by rising log time.

        What is in memory at a time is the extents that overlap in time, or TOGETHER_BYTES of small ones, however long
        the files are.
        """
        names = tuple(sorted(topics))
        extents = [(file, extent) for file in self._files for extent in file.contents.extents]
        extents.sort(key=lambda item: (item[1].start, item[1].end))  # equal ones as in the files
        runs = groupby(extents, key=itemgetter(0))
        return merge(
            block
            for file, run in runs
            for block in file.blocks((extent for _, extent in run), names)
        )


def _topics(files: Sequence[McapFile]) -> tuple[Topic, ...]:
    found: dict[str, Topic] = {}
    for file in files:
        for number, channel in sorted(file.contents.channels.items()):
            schema = file.contents.schemas.get(channel.schema_id)
            known = found.get(channel.topic)
            if known and schema and known.type_name != schema.name:
                raise BagError(
                    f"{file.path}: {channel.topic} is both {known.type_name} and {schema.name}"
                )
            count = file.contents.counts.get(number, 0)
            found[channel.topic] = Topic(
                name=channel.topic,
                type_name=schema.name if schema else "",
                count=count + (known.count if known else 0),
                definition=schema.data.decode(errors="replace") if schema else "",
                definition_format=schema.encoding if schema else "",
                encoding=channel.message_encoding,
                metadata=known.metadata if known else tuple(channel.metadata.items()),
            )
    return tuple(found[name] for name in sorted(found))


def _span(files: Sequence[McapFile]) -> tuple[int, int]:
    extents = [extent for file in files for extent in file.contents.extents]
    if not extents:
        return 0, 0
    return min(extent.start for extent in extents), max(extent.end for extent in extents)
