# SPDX-License-Identifier: Apache-2.0
"""Commands to a running recorder: start, stop, pause, resume, split, snapshot."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from operator import methodcaller
from pathlib import Path

from worm_model.bags.formats.bag_errors import BagError
from worm_model.bags.formats.bag_metadata import first_qos_profile
from worm_model.bags.formats.bag_writer import WriteOptions
from worm_model.bags.formats.message_block import Message, Topic
from worm_model.bags.opening import is_unclosed
from worm_model.bags.recording.recorder import BagRecorder, Manifest
from worm_model.bags.recording.recording_thread import RecordingThread, Tally

# bytes, largest size of the messages that wait for the disk, and of the ring buffer: rosbag2's default cache size
BACKLOG_BYTES = 100 * 2**20


@dataclass(frozen=True)
class SessionOptions:
    """Content and location of a recording.

    Attributes:
        output: path of the first bag. Later bags end in ``_2`` and so on, snapshots in ``_snapshot_1`` and so on.
        manifest: returns the manifest of a bag that begins now.
        write: options of writing.
        sync_s: longest time between synchronisations, s.
        ring_s: length of the ring buffer in memory, s. Its messages are written only by `RecordingSession.snapshot`.
            0: no ring buffer; all messages are written immediately.
    """

    output: Path
    manifest: Callable[[], Manifest]
    write: WriteOptions = field(default_factory=WriteOptions)
    sync_s: float = 0.5
    ring_s: float = 0.0


class RecordingSession:
    """Sequence of the bags of a recorder. Not thread-safe: one thread calls it.

    The methods `start`, `stop`, `pause`, `resume`, `split` and `snapshot` return a text about the outcome.

    Raises:
        BagError: In the constructor, `start` and `snapshot`, if the new bag exists. In `stop` and `split`, if nothing
            is being recorded. In `snapshot`, if there is no ring buffer or no new message.
        OSError: In the constructor, `start` and `snapshot`, if the new bag cannot be created.
    """

    def __init__(self, options: SessionOptions) -> None:
        self.options = options
        self.is_paused = False
        self.bags: list[Path] = []
        self._threads: list[RecordingThread] = []
        self._current: RecordingThread | None = None
        self._ring = _Ring(round(options.ring_s * 1e9))
        self._numbers = {"": 0, "_snapshot": 0}
        self._notes: dict[str, Mapping[str, str]] = {}
        self._topics: dict[Topic, None] = {}
        if not options.ring_s:
            self.start()

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
        return sum((thread.offered for thread in self._threads), Tally())

    @property
    def dropped(self) -> Tally:
        """Offered messages that were not written to the disk."""
        return sum((thread.dropped for thread in self._threads), Tally())

    def offer(self, messages: Sequence[Message]) -> None:
        """Record messages, unless the recording is paused or stopped; never block."""
        if self.is_paused or not messages:
            return
        if self.options.ring_s:
            self._ring.add(messages)
        elif self._current is not None:
            self._current.offer(messages)

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

    def start(self) -> str:
        """Begin a bag, or continue a paused one."""
        if self.options.ring_s:
            return self.resume()
        if self._current is None:
            self._current = self._begin("")
        self.is_paused = False
        return f"recording to {self._current.directory}"

    def stop(self) -> str:
        """End the bag; `start` begins another one."""
        if self._current is None:
            raise BagError("nothing is being recorded")
        directory = self._current.directory
        self._current.finish()
        self._current = None
        return f"{directory} is closed"

    def pause(self) -> str:
        """Discard messages until `resume`."""
        self.is_paused = True
        return "paused"

    def resume(self) -> str:
        """Record messages again."""
        self.is_paused = False
        return "recording"

    def split(self) -> str:
        """Continue in a new file of the bag."""
        if self._current is None:
            raise BagError("nothing is being recorded")
        self._current.act(BagRecorder.split)
        return f"{self._current.directory} continues in a new file"

    def snapshot(self) -> str:
        """Write the content of the ring buffer into a separate bag."""
        if not self.options.ring_s:
            raise BagError("there is no ring buffer: record with --snapshot S")
        if not self._ring:
            raise BagError("nothing has been received since the last snapshot")
        thread = self._begin("_snapshot")  # If this fails, the messages stay for the next snapshot.
        thread.offer(self._ring.take())
        thread.finish()
        return f"the last {self.options.ring_s:g} s are written to {thread.directory}"

    def close(self) -> None:
        """End all bags and wait for their threads."""
        if self._current is not None:
            self._current.finish()
            self._current = None
        for thread in self._threads:
            thread.close()

    def _begin(self, kind: str) -> RecordingThread:
        self._numbers[kind] += 1
        number = self._numbers[kind]
        output = self.options.output
        suffix = kind if number == 1 and not kind else f"{kind}_{number}"
        directory = Path(f"{output}{suffix}")
        recorder = BagRecorder(directory, self.options.manifest(), self.options.write)
        for name, values in self._notes.items():
            recorder.add_metadata(name, values)
        for topic in self._topics:
            recorder.add_topic(topic)
        limit = BACKLOG_BYTES * (2 if kind else 1)  # a snapshot is queued as a whole
        thread = RecordingThread(recorder, self.options.sync_s, limit)
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


def is_latched(topic: Topic) -> bool:
    """Return True if a topic was published with transient-local durability: later subscribers receive it."""
    durability = first_qos_profile(topic).get("durability")
    return durability in ("transient_local", 1)  # metadata.yaml contains numbers before version 9
