# SPDX-License-Identifier: Apache-2.0
"""What a recorder is asked for while it runs: start, stop, pause, resume, split, snapshot."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from operator import methodcaller
from pathlib import Path

from worm_model.bags.bag_errors import BagError
from worm_model.bags.bag_metadata import first_qos_profile
from worm_model.bags.bag_writer import WriteOptions
from worm_model.bags.message_block import Message, Topic
from worm_model.bags.recorder import BagRecorder, Manifest
from worm_model.bags.recording_thread import RecordingThread, Tally

BACKLOG_BYTES = 100 * 2**20  # rosbag2's cache; also what a ring holds at most


@dataclass(frozen=True)
class SessionOptions:
    """What is recorded where.

    Attributes:
        output: the first bag; the next ones get numbers from 2 on, snapshots ``_snapshot_1`` and so on.
        manifest: what goes into a bag that is begun now.
        write: how it is written.
        sync_s: longest time between synchronisations, s.
        ring_s: the last so many seconds are kept in memory and written when asked for, nothing else; 0: all is
            written as it comes.
    """

    output: Path
    manifest: Callable[[], Manifest]
    write: WriteOptions = field(default_factory=WriteOptions)
    sync_s: float = 0.5
    ring_s: float = 0.0


class RecordingSession:
    """The bags of a recorder, one after the other. Not thread-safe: one thread asks.

    Raises:
        BagError: in `start` and what begins a bag: it exists already.
        OSError: likewise: it cannot be made.
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
        """What ended the writing of a bag before its time."""
        return next((t.error for t in self._threads if t.error is not None), None)

    @property
    def failed(self) -> Path | None:
        """The bag whose writing ended before its time."""
        return next((t.directory for t in self._threads if t.error is not None), None)

    @property
    def offered(self) -> Tally:
        """Messages that were to be written."""
        return sum((thread.offered for thread in self._threads), Tally())

    @property
    def dropped(self) -> Tally:
        """Those of them that the disk did not take."""
        return sum((thread.dropped for thread in self._threads), Tally())

    def offer(self, messages: Sequence[Message]) -> None:
        """Keep messages, unless the recording is paused or stopped; never waits."""
        if self.is_paused or not messages:
            return
        if self.options.ring_s:
            self._ring.add(messages)
        elif self._current is not None:
            self._current.offer(messages)

    def know(self, topics: Iterable[Topic]) -> None:
        """Keep topics even if no message of them comes, also in the bags that follow."""
        new = [topic for topic in topics if topic not in self._topics]
        self._topics.update(dict.fromkeys(new))
        if self._current is not None:
            for topic in new:
                self._current.act(methodcaller("add_topic", topic))

    def note(self, name: str, values: Mapping[str, str]) -> None:
        """Keep a metadata record, also for the bags that follow."""
        self._notes[name] = values
        if self._current is not None:
            self._current.act(methodcaller("add_metadata", name, values))

    def start(self) -> str:
        """Begin a bag, or go on with one that is paused."""
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
        """Let messages pass until `resume`."""
        self.is_paused = True
        return "paused"

    def resume(self) -> str:
        """Keep messages again."""
        self.is_paused = False
        return "recording"

    def split(self) -> str:
        """Go on in a new file of the bag."""
        if self._current is None:
            raise BagError("nothing is being recorded")
        self._current.act(BagRecorder.split)
        return f"{self._current.directory} goes on in a new file"

    def snapshot(self) -> str:
        """Write what the ring holds into a bag of its own."""
        if not self.options.ring_s:
            raise BagError("there is no ring: record with --snapshot S")
        messages = self._ring.take()
        if not messages:
            raise BagError("nothing has been received since the last snapshot")
        thread = self._begin("_snapshot")
        thread.offer(messages)
        thread.finish()
        return f"the last {self.options.ring_s:g} s are written to {thread.directory}"

    def close(self) -> None:
        """End all bags and wait for them."""
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
        limit = BACKLOG_BYTES * (2 if kind else 1)  # a ring comes at once
        thread = RecordingThread(recorder, self.options.sync_s, limit)
        self._threads.append(thread)
        self.bags.append(directory)
        return thread


class _Ring:
    """The messages of the last so many ns, at most BACKLOG_BYTES, and the last older one of each latched topic."""

    def __init__(self, length_ns: int) -> None:
        self._length_ns = length_ns
        self._bytes = 0
        self._messages: deque[Message] = deque()
        self._latched: dict[str, Message] = {}

    def add(self, messages: Sequence[Message]) -> None:
        """Append messages in the order of reception; the oldest ones go."""
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
        """All messages; the ring is then empty, but for what is latched."""
        if not self._messages:
            return []
        messages = [*self._latched.values(), *self._messages]
        self._latched |= {m.topic: m for m in self._messages if is_latched(m.channel)}
        self._messages.clear()
        self._bytes = 0
        return messages


def is_latched(topic: Topic) -> bool:
    """Whether a topic was published for those who come later, too."""
    durability = first_qos_profile(topic).get("durability")
    return durability in ("transient_local", 1)  # a number before version 9
