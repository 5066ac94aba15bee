# SPDX-License-Identifier: Apache-2.0
"""Thread that writes a bag, so that a slow disk never delays the reception of messages."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Sequence
from typing import NamedTuple

from worm_model.bags.formats.message_block import Message
from worm_model.bags.recording.recorder import BagRecorder


class Tally(NamedTuple):
    """Number of messages and size of their payload, bytes."""

    messages: int = 0
    bytes: int = 0

    def plus(self, other: Tally) -> Tally:
        """Return the sum of both."""
        return Tally(self.messages + other.messages, self.bytes + other.bytes)

    def minus(self, other: Tally) -> Tally:
        """Return the difference of both."""
        return Tally(self.messages - other.messages, self.bytes - other.bytes)


def tally(batch: Sequence[Message]) -> Tally:
    """Count the messages of a batch."""
    return Tally(len(batch), sum(len(message.data) for message in batch))


Act = Callable[[BagRecorder], None]


class RecordingThread:
    """Thread that writes messages, regularly synchronises the bag (`BagRecorder.sync`), and closes it at the end.

    Args:
        recorder: the bag; from now on only the thread uses it.
        sync_s: longest time between synchronisations, s.
        backlog_bytes: largest payload (bytes) that may wait for the disk; further messages are dropped and counted.

    Attributes:
        offered: messages passed to `offer`.
        dropped: offered messages that are not in the bag. After an error, messages that were not synchronised count
            as dropped, although some of them may be in the file.
        error: error that ended the writing early, or None.
    """

    def __init__(self, recorder: BagRecorder, sync_s: float, backlog_bytes: int) -> None:
        self.directory = recorder.directory
        self._recorder = recorder
        self._sync_s = sync_s
        self._backlog_limit = backlog_bytes
        self._accounting = threading.Lock()
        self._backlog = Tally()  # accepted, and not synchronised yet
        self._queue: queue.SimpleQueue[Sequence[Message] | Act | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._run, name="bag writer")
        self.offered = self.dropped = Tally()
        self.error: Exception | None = None
        self._thread.start()

    def offer(self, batch: Sequence[Message]) -> None:
        """Queue messages for writing; never block."""
        new = tally(batch)
        with self._accounting:
            self.offered = self.offered.plus(new)
            longer = self._backlog.plus(new)
            if self.error is None and longer.bytes <= self._backlog_limit:
                self._backlog = longer
                self._queue.put(batch)
            else:
                self.dropped = self.dropped.plus(new)

    def act(self, act: Act) -> None:
        """Queue another operation on the bag, after the messages offered so far."""
        self._queue.put(act)

    def finish(self) -> None:
        """Let the thread write the queued messages and close the bag, without waiting for it."""
        self._queue.put(None)

    def close(self) -> None:
        """Write the queued messages, close the bag, and wait until the thread ends; `error` is None on success."""
        self.finish()
        self._thread.join()

    def _run(self) -> None:
        try:
            self._write_all()
            self._recorder.close()
        except Exception as error:  # noqa: BLE001 - any error ends the recording
            self._recorder.abandon()
            with self._accounting:  # from now on, `offer` drops messages
                self.error = error
                self.dropped = self.dropped.plus(self._backlog)

    def _write_all(self) -> None:
        written, due = Tally(), time.monotonic() + self._sync_s
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
                self._recorder.write_all(item)
                written = written.plus(tally(item))
            if time.monotonic() >= due:
                self._recorder.sync()
                with self._accounting:
                    self._backlog = self._backlog.minus(written)
                written, due = Tally(), time.monotonic() + self._sync_s
