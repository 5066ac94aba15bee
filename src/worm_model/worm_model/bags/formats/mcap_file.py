# SPDX-License-Identifier: Apache-2.0
"""MCAP files, open for reading."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Attachment

from worm_model.bags.formats import mcap_records
from worm_model.bags.formats.bag_errors import BagError
from worm_model.bags.formats.bag_metadata import named_qos
from worm_model.bags.formats.contents import AttachedFile, Contents, Extent
from worm_model.bags.formats.mcap_contents import extent_records, salvage, scan
from worm_model.bags.formats.message_block import Messages, Topic
from worm_model.bags.formats.stored_file import StoredFile, explained

# largest size (bytes) of a block of several extents; fewer blocks need fewer calls of numpy
TOGETHER_BYTES = 1 << 20


class McapFile(StoredFile):
    """MCAP file. If checksums and summary match the data, opening it decodes only the heads of chunks."""

    survey: Callable[[mcap_records.Buffer], Contents] = staticmethod(scan)

    def _survey(self) -> Contents:
        if self.data[: len(mcap_records.MAGIC)] != mcap_records.MAGIC:
            first = bytes(self.data[: len(mcap_records.MAGIC)])
            raise BagError(
                f"{self.path} is not an MCAP file: it begins with {first!r}, not {mcap_records.MAGIC!r}"
            )
        return self.survey(self.data)

    @property
    def channels(self) -> dict[int, Topic]:
        """Topics by the number of their channel, without their counts."""
        topics = {}
        for number, channel in sorted(self.contents.channels.items()):
            schema = self.contents.schemas.get(channel.schema_id)
            topics[number] = Topic(
                name=channel.topic,
                type_name=schema.name if schema else "",
                count=0,
                definition=schema.data.decode(errors="replace") if schema else "",
                definition_format=schema.encoding if schema else "",
                encoding=channel.message_encoding,
                metadata=tuple(
                    (key, named_qos(text) if key == "offered_qos_profiles" else text)
                    for key, text in channel.metadata.items()
                ),
            )
        return topics

    def blocks(
        self, extents: Iterable[Extent], topics: frozenset[str]
    ) -> Iterator[tuple[int, Messages]]:
        """Yield (start in ns, block) for the messages of some topics in extents that are in order of start.

        Consecutive small extents form one block, because a recorder that often synchronises writes many small
        chunks.
        """
        start, end, size = 0, 0, 0
        parts: list[mcap_records.Buffer] = []
        with explained(self.path):
            for extent in extents:
                records = extent_records(self.data, extent)
                mcap_records.release(self.data)
                if parts and size + len(records) > TOGETHER_BYTES:
                    yield start, self._messages(parts, (start, end), topics)
                    parts, end, size = [], 0, 0
                start, end = start if parts else extent.start, max(end, extent.end)
                parts.append(records)
                size += len(records)
            if parts:
                yield start, self._messages(parts, (start, end), topics)

    def _messages(
        self, parts: Sequence[mcap_records.Buffer], span: tuple[int, int], topics: frozenset[str]
    ) -> Messages:
        """Return messages of some topics in the order of the file.

        Raises ValueError if the log time of a message is outside of ``span`` (first and last log time, ns).
        """
        records = b"".join(parts) if len(parts) > 1 else parts[0]
        offset, heads = mcap_records.message_heads(records)
        times = heads["log_time"]
        if len(times) and not (span[0] <= int(times.min()) and int(times.max()) <= span[1]):
            raise ValueError("a message lies outside of the time span of its chunk")
        channels = self.channels
        lookup = np.full(1 << 16, -1)
        for row, (number, topic) in enumerate(channels.items()):
            lookup[number] = row if topic.name in topics else -1
        channel = lookup[heads["channel"].astype(np.int64)]
        rows = np.flatnonzero(channel >= 0)
        return Messages(
            tuple(channels.values()),
            np.frombuffer(records, np.uint8),
            channel[rows],
            offset[rows] + mcap_records.HEAD.itemsize,
            heads["length"][rows].astype(np.int64) - mcap_records.MESSAGE_BODY,
            times[rows].astype(np.uint64),
            heads["publish_time"][rows].astype(np.uint64),
        )

    def attachments(self) -> Iterator[AttachedFile]:
        """Yield the attached files."""
        for first, last in self.contents.attachments:
            attached = mcap_records.read_record(Opcode.ATTACHMENT, self.data[first:last])
            assert isinstance(attached, Attachment)
            yield AttachedFile(attached.name, attached.media_type, attached.data)


class SalvagedMcapFile(McapFile):
    """MCAP file from which all intact data is read, even if other data is damaged."""

    survey = staticmethod(salvage)
