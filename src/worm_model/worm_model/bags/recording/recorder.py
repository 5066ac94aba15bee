# SPDX-License-Identifier: Apache-2.0
"""Recorder of raw CDR messages into a bag that stays readable if the recorder is killed, and its thread.

Each call of `sync` closes, flushes and fsyncs the open chunk. ``kill -9`` or a power cut then loses only the messages
since the last call. A bag has a provisional metadata.yaml from the start. Nothing is ever overwritten.
"""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from worm_model.bags.formats.bag_errors import ExistsError
from worm_model.bags.formats.bag_metadata import CLOSED, STATE, UNFINISHED, sync_directory
from worm_model.bags.formats.bag_writer import BagWriter
from worm_model.bags.formats.message_block import Message
from worm_model.bags.formats.stored_file import AttachedFile


@dataclass(frozen=True)
class Manifest:
    """Data of a run in addition to its messages.

    Attributes:
        metadata: MCAP metadata records by name, each with text by key.
        attachments: files stored in the bag.
    """

    metadata: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    attachments: tuple[AttachedFile, ...] = ()


class BagRecorder(BagWriter):
    """Bag that is being recorded. Not thread-safe: one thread writes.

    Args:
        directory: the bag, a directory that must not exist.
        manifest: data of the run.

    Raises:
        ExistsError: The directory exists.
        OSError: The directory cannot be created or written.
    """

    def __init__(self, directory: Path, manifest: Manifest) -> None:
        try:
            directory.mkdir(parents=True)
        except FileExistsError:
            raise ExistsError(
                f"{directory} exists already and is not overwritten; choose another name"
            ) from None
        super().__init__(directory, directory.name, {STATE: UNFINISHED})
        for name, values in manifest.metadata.items():
            self.add_metadata(name, values)
        for attached in manifest.attachments:
            self.add_attachment(attached)
        self.sync()
        self.describe()
        sync_directory(directory.parent)

    def close(self) -> None:
        """Finish the bag: index, summary and the final metadata.yaml."""
        self.custom = {STATE: CLOSED}
        self.sync()
        self.finish()


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
