# SPDX-License-Identifier: Apache-2.0
"""Recording into a bag, or into snapshots of the last seconds."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Sequence
from operator import methodcaller
from pathlib import Path

from worm_model.bags.formats.bag_errors import BagError
from worm_model.bags.formats.bag_metadata import is_latched, is_unclosed
from worm_model.bags.formats.message_block import Message, Topic
from worm_model.bags.recording.recorder import BagRecorder, Manifest

RING_BYTES = 100 * 2**20  # largest size of the messages in a ring buffer


class RecordingSession:
    """Bags of a recorder. Not thread-safe: one thread calls it.

    Args:
        output: path of the bag. Snapshots end in ``_snapshot_1`` and so on.
        manifest: returns the manifest of a bag that begins now.
        ring_s: length of the ring buffer in memory, s. Its messages are written only by `snapshot`. 0: no ring buffer;
            all messages are written immediately.

    Attributes:
        bags: the bags that were begun.
        messages, bytes: number and payload (bytes) of the messages in them.
        error: error that ended the writing of the bag early, or None.
    """

    def __init__(self, output: Path, manifest: Callable[[], Manifest], ring_s: float = 0.0) -> None:
        self.output = output
        self.ring_s = ring_s
        self.bags: list[Path] = []
        self.messages = self.bytes = 0
        self.error: OSError | None = None
        self._manifest = manifest
        self._ring = _Ring(round(ring_s * 1e9))
        self._snapshots = 0
        self._topics: dict[Topic, None] = {}
        self._bag = None if ring_s else self._begin(output)

    def offer(self, messages: Sequence[Message]) -> None:
        """Record messages, and synchronise the bag with the disk when this is due."""
        if self.ring_s:
            self._ring.add(messages)
        else:
            self._write(methodcaller("record", messages))
            if self.error is None:
                self._count(messages)

    def add_topics(self, topics: Iterable[Topic]) -> None:
        """Add topics; the present and the following bags list them even without messages."""
        for topic in topics:
            if topic not in self._topics:
                self._topics[topic] = None
                self._write(methodcaller("add_topic", topic))

    def snapshot(self) -> str:
        """Write the content of the ring buffer into a separate bag, and return a text about the outcome."""
        if not self.ring_s:
            raise BagError("there is no ring buffer: record with --snapshot S")
        messages = self._ring.content()
        if not messages:
            raise BagError("nothing has been received since the last snapshot")
        self._snapshots += 1
        directory = Path(f"{self.output}_snapshot_{self._snapshots}")
        bag = self._begin(directory)
        try:
            bag.write_all(messages)
            bag.close()
        finally:
            bag.abandon()
        self._ring.clear()  # Before this, an error keeps the messages for the next snapshot.
        self._count(messages)
        return f"the last {self.ring_s:g} s are written to {directory}"

    def close(self) -> None:
        """End the bag."""
        self._write(methodcaller("close"))

    def _begin(self, directory: Path) -> BagRecorder:
        bag = BagRecorder(directory, self._manifest())
        self.bags.append(directory)
        for topic in self._topics:
            bag.add_topic(topic)
        return bag

    def _write(self, act: Callable[[BagRecorder], None]) -> None:
        """Apply an operation to the bag. An error of the operating system ends the recording."""
        if self._bag is not None:
            try:
                act(self._bag)
            except OSError as error:
                self._bag.abandon()
                self._bag, self.error = None, error

    def _count(self, messages: Sequence[Message]) -> None:
        self.messages += len(messages)
        self.bytes += sum(len(message.data) for message in messages)


def after_crash(output: Path) -> Path:
    """Return the first of OUTPUT, OUTPUT_2, OUTPUT_3 and so on that is not an unclosed bag."""
    number, directory = 1, output
    while directory.is_dir() and is_unclosed(directory):
        number += 1
        directory = Path(f"{output}_{number}")
    return directory


class _Ring:
    """Ring buffer with the messages of the last ``length_ns``, but at most RING_BYTES.

    In addition, it stores for each latched topic the latest of the messages that were removed.
    """

    def __init__(self, length_ns: int) -> None:
        self._length_ns = length_ns
        self._bytes = 0
        self._messages: deque[Message] = deque()
        self._latched: dict[str, Message] = {}

    def add(self, messages: Sequence[Message]) -> None:
        """Append messages in the order of reception, and remove the oldest messages beyond the limits."""
        self._messages.extend(messages)
        self._bytes += sum(len(message.data) for message in messages)
        newest = self._messages[-1].log_time if self._messages else 0
        while self._messages and (
            self._messages[0].log_time < newest - self._length_ns or self._bytes > RING_BYTES
        ):
            self._remove_oldest()

    def content(self) -> list[Message]:
        """Return all messages; empty if none was added since the last `clear`."""
        return [*self._latched.values(), *self._messages] if self._messages else []

    def clear(self) -> None:
        """Remove all messages, except for the last one of each latched topic."""
        while self._messages:
            self._remove_oldest()

    def _remove_oldest(self) -> None:
        gone = self._messages.popleft()
        self._bytes -= len(gone.data)
        if is_latched(gone.channel):
            self._latched[gone.topic] = gone
