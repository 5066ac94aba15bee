# SPDX-License-Identifier: Apache-2.0
"""Recording into a bag, or into snapshots of the last seconds."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import reduce
from operator import methodcaller
from pathlib import Path

from worm_model.bags.formats.bag_errors import BagError
from worm_model.bags.formats.bag_metadata import is_latched, is_unclosed
from worm_model.bags.formats.message_block import Message, Topic
from worm_model.bags.recording.recorder import BagRecorder, Manifest, RecordingThread, Tally

# bytes, largest size of the messages that wait for the disk, and of the ring buffer: rosbag2's default cache size
BACKLOG_BYTES = 100 * 2**20
SYNC_S = 0.5  # longest time between synchronisations of a bag


class RecordingSession:
    """Bags of a recorder. Not thread-safe: one thread calls it.

    Args:
        output: path of the bag. Snapshots end in ``_snapshot_1`` and so on.
        manifest: returns the manifest of a bag that begins now.
        ring_s: length of the ring buffer in memory, s. Its messages are written only by `snapshot`. 0: no ring buffer;
            all messages are written immediately.

    Raises:
        BagError: In the constructor and `snapshot`, if the new bag exists. In `snapshot`, if there is no ring buffer or
            no new message.
        OSError: In the constructor and `snapshot`, if the new bag cannot be created.
    """

    def __init__(self, output: Path, manifest: Callable[[], Manifest], ring_s: float = 0.0) -> None:
        self.output = output
        self.ring_s = ring_s
        self.bags: list[Path] = []
        self._snapshots = 0
        self._manifest = manifest
        self._threads: list[RecordingThread] = []
        self._ring = _Ring(round(ring_s * 1e9))
        self._notes: dict[str, Mapping[str, str]] = {}
        self._topics: dict[Topic, None] = {}
        self._current = None if ring_s else self._begin(output, BACKLOG_BYTES)

    @property
    def error(self) -> Exception | None:
        """Error that ended the writing of a bag early, or None."""
        return next((t.error for t in self._threads if t.error is not None), None)

    @property
    def failed(self) -> Path | None:
        """Bag whose writing ended early, or None."""
        return next((t.directory for t in self._threads if t.error is not None), None)

    @property
    def offered(self) -> Tally:
        """Messages passed on for writing."""
        return reduce(Tally.plus, (thread.offered for thread in self._threads), Tally())

    @property
    def dropped(self) -> Tally:
        """Offered messages that were not written to the disk."""
        return reduce(Tally.plus, (thread.dropped for thread in self._threads), Tally())

    def offer(self, messages: Sequence[Message]) -> None:
        """Record messages; never block."""
        if self._current is not None:
            self._current.offer(messages)
        elif messages:
            self._ring.add(messages)

    def add_topics(self, topics: Iterable[Topic]) -> None:
        """Add topics; the present and the following bags list them even without messages."""
        new = [topic for topic in topics if topic not in self._topics]
        self._topics.update(dict.fromkeys(new))
        if self._current is not None:
            for topic in new:
                self._current.act(methodcaller("add_topic", topic))

    def note(self, name: str, values: Mapping[str, str]) -> None:
        """Add a metadata record to the present and the following bags."""
        self._notes[name] = values
        if self._current is not None:
            self._current.act(methodcaller("add_metadata", name, values))

    def snapshot(self) -> str:
        """Write the content of the ring buffer into a separate bag, and return a text about the outcome."""
        if not self.ring_s:
            raise BagError("there is no ring buffer: record with --snapshot S")
        if not self._ring:
            raise BagError("nothing has been received since the last snapshot")
        self._snapshots += 1
        directory = Path(f"{self.output}_snapshot_{self._snapshots}")
        # If this fails, the messages stay for the next snapshot. A snapshot is queued as a whole.
        thread = self._begin(directory, 2 * BACKLOG_BYTES)
        thread.offer(self._ring.take())
        thread.finish()
        return f"the last {self.ring_s:g} s are written to {directory}"

    def close(self) -> None:
        """End all bags and wait for their threads."""
        for thread in self._threads:
            thread.close()

    def _begin(self, directory: Path, backlog_bytes: int) -> RecordingThread:
        recorder = BagRecorder(directory, self._manifest())
        for name, values in self._notes.items():
            recorder.add_metadata(name, values)
        for topic in self._topics:
            recorder.add_topic(topic)
        thread = RecordingThread(recorder, SYNC_S, backlog_bytes)
        self._threads.append(thread)
        self.bags.append(directory)
        return thread


def after_crash(output: Path) -> Path:
    """Return the first of OUTPUT, OUTPUT_2, OUTPUT_3 and so on that is not an unclosed bag."""
    number, directory = 1, output
    while directory.is_dir() and is_unclosed(directory):
        number += 1
        directory = Path(f"{output}_{number}")
    return directory


class _Ring:
    """Ring buffer with the messages of the last ``length_ns``, but at most BACKLOG_BYTES.

    In addition, it stores for each latched topic the latest of the messages that were removed.
    """

    def __init__(self, length_ns: int) -> None:
        self._length_ns = length_ns
        self._bytes = 0
        self._messages: deque[Message] = deque()
        self._latched: dict[str, Message] = {}

    def __len__(self) -> int:
        """Number of messages since the last `take`."""
        return len(self._messages)

    def add(self, messages: Sequence[Message]) -> None:
        """Append messages in the order of reception, and remove the oldest messages beyond the limits."""
        self._messages.extend(messages)
        self._bytes += sum(len(message.data) for message in messages)
        oldest = self._messages[-1].log_time - self._length_ns
        while self._messages and (
            self._messages[0].log_time < oldest or self._bytes > BACKLOG_BYTES
        ):
            gone = self._messages.popleft()
            self._bytes -= len(gone.data)
            if is_latched(gone.channel):
                self._latched[gone.topic] = gone

    def take(self) -> list[Message]:
        """Return all messages and empty the ring buffer, except for the last message of each latched topic."""
        messages = [*self._latched.values(), *self._messages]
        self._latched |= {m.topic: m for m in self._messages if is_latched(m.channel)}
        self._messages.clear()
        self._bytes = 0
        return messages
