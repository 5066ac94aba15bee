# SPDX-License-Identifier: Apache-2.0
"""A thread that writes a bag, so that a slow disk never holds up the reception of messages."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from worm_model.bags.message_block import Message
from worm_model.bags.recorder import BagRecorder


@dataclass
class Tally:
    """A number of messages and the size of their payload, bytes."""

    messages: int = 0
    bytes: int = 0

    def add(self, batch: Sequence[Message]) -> None:
        """Count the messages of a batch."""
        self.messages += len(batch)
        self.bytes += sum(len(message.data) for message in batch)

    def __add__(self, other: Tally) -> Tally:
        return Tally(self.messages + other.messages, self.bytes + other.bytes)


Act = Callable[[BagRecorder], None]


class RecordingThread:
    """Writes what it is offered, synchronises in time, and closes the bag at the end.

    Args:
        recorder: the bag; the thread owns it from now on.
        sync_s: longest time between synchronisations, s.
        backlog_bytes: payload that may wait for the disk; what comes on top is dropped and counted.

    Attributes:
        offered: messages that were handed over.
        dropped: those of them that are not in the bag; after an error also those that had not been synchronised, of
            which a recovery may still find some, and all of them if the bag was removed.
        error: what ended the writing before its time.
    """

    def __init__(self, recorder: BagRecorder, sync_s: float, backlog_bytes: int) -> None:
        self.directory = recorder.directory
        self._recorder = recorder
        self._sync_s = sync_s
        self._backlog_limit = backlog_bytes
        self._backlog = 0
        self._accounting = threading.Lock()
        self._unsynchronised: list[Sequence[Message]] = []
        self._synchronised = Tally()
        self._queue: queue.SimpleQueue[Sequence[Message] | Act | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._run, name="bag writer")
        self.offered = Tally()
        self.dropped = Tally()
        self.error: Exception | None = None
        self._thread.start()

    def offer(self, batch: Sequence[Message]) -> None:
        """Hand over messages to be written; never waits."""
        size = sum(len(message.data) for message in batch)
        with self._accounting:
            self.offered.add(batch)
            if self.error is not None or self._backlog + size > self._backlog_limit:
                self.dropped.add(batch)
                return
            self._backlog += size
            self._queue.put(batch)

    def act(self, act: Act) -> None:
        """Hand over what else is to be done with the bag, behind what has been offered."""
        self._queue.put(act)

    def finish(self) -> None:
        """Write what is left and close the bag, without waiting for it."""
        self._queue.put(None)

    def close(self) -> None:
        """Write what is left, close the bag, and wait for it; `error` then tells whether all went well."""
        self.finish()
        self._thread.join()

    def _run(self) -> None:
        try:
            self._write_all()
            self._recorder.close()
        except Exception as error:  # noqa: BLE001 - whatever it is, the recording is over, and says so
            self._recorder.abandon()
            with self._accounting:  # from now on, `offer` drops
                self.error = error
                if isinstance(error, FileNotFoundError):
                    self.dropped += self._synchronised  # gone with the folder
                for batch in [*self._unsynchronised, *self._waiting()]:
                    self.dropped.add(batch)

    def _write_all(self) -> None:
        due = time.monotonic() + self._sync_s
        while True:
            try:
                item = self._queue.get(timeout=max(due - time.monotonic(), 0.0))
            except queue.Empty:
                item = ()
            if item is None:
                return
            if callable(item):
                item(self._recorder)
            else:
                self._write(item)
            if time.monotonic() >= due:
                self._recorder.sync()
                for written in self._unsynchronised:
                    self._synchronised.add(written)
                self._unsynchronised.clear()
                due = time.monotonic() + self._sync_s

    def _write(self, batch: Sequence[Message]) -> None:
        self._unsynchronised.append(batch)
        self._recorder.write_all(batch)
        with self._accounting:
            self._backlog -= sum(len(message.data) for message in batch)

    def _waiting(self) -> Iterator[Sequence[Message]]:
        """What nobody will write any more."""
        while not self._queue.empty():
            item = self._queue.get()
            if item is not None and not callable(item):
                yield item
