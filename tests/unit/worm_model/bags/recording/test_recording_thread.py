# SPDX-License-Identifier: Apache-2.0
"""The thread that writes a bag."""

import errno
import threading
from operator import methodcaller
from pathlib import Path

from worm_model.bags.formats.message_block import Message, Topic
from worm_model.bags.opening import open_bag
from worm_model.bags.recording.recorder import BagRecorder, Manifest, RecordingThread, Tally

TOPIC = Topic("/counter", "std_msgs/msg/UInt64", 0, "uint64 data\n", "ros2msg", "cdr")
DEADLINE_S = 30.0


def sample(value: int) -> Message:
    data = b"\x00\x01\x00\x00" + value.to_bytes(8, "little")
    return Message(TOPIC.name, value + 1, data, value + 1, TOPIC)


def recorder(directory: Path) -> BagRecorder:
    return BagRecorder(directory, Manifest())


def test_everything_offered_is_written_in_order(tmp_path: Path):
    thread = RecordingThread(recorder(tmp_path / "bag"), sync_s=0.01, backlog_bytes=10**6)
    for i in range(0, 300, 3):
        thread.offer([sample(i), sample(i + 1), sample(i + 2)])
    thread.act(methodcaller("add_metadata", "worm_gait", {"stroke": "0.07"}))
    thread.close()
    assert (thread.error, thread.dropped) == (None, Tally())
    with open_bag(tmp_path / "bag") as bag:
        assert [m.log_time for m in bag.messages()] == list(range(1, 301))
        assert bag.metadata["worm_gait"] == {"stroke": "0.07"}


class Held(BagRecorder):
    """Recorder that writes only when allowed, and signals its synchronisation."""

    def __init__(self, directory: Path) -> None:
        self.allowed = threading.Event()
        self.synchronised = threading.Event()
        super().__init__(directory, Manifest())

    def write(self, *arguments) -> None:
        assert self.allowed.wait(DEADLINE_S)
        super().write(*arguments)

    def sync(self) -> None:
        super().sync()
        if sum(self._counts.values()):
            self.synchronised.set()


def test_what_does_not_fit_into_the_backlog_is_dropped_and_counted(tmp_path: Path):
    held = Held(tmp_path / "bag")
    thread = RecordingThread(held, sync_s=10.0, backlog_bytes=12 * 5)
    thread.offer([sample(i) for i in range(5)])
    thread.offer([sample(5), sample(6)])
    held.allowed.set()
    thread.close()
    assert thread.dropped == Tally(2, 24)
    with open_bag(tmp_path / "bag") as bag:
        assert bag.message_count == 5


class Broken(BagRecorder):
    """Recorder on a disk that is full at the third message."""

    def write(self, *arguments) -> None:
        if sum(self._counts.values()) == 2:
            raise OSError(errno.ENOSPC, "No space left on device")
        super().write(*arguments)


def test_a_full_disk_is_reported_and_later_messages_are_counted_as_dropped(tmp_path: Path):
    thread = RecordingThread(Broken(tmp_path / "bag", Manifest()), sync_s=10.0, backlog_bytes=10**6)
    for i in range(10):
        thread.offer([sample(2 * i), sample(2 * i + 1)])
    thread.close()
    assert isinstance(thread.error, OSError)
    assert thread.error.errno == errno.ENOSPC
    thread.offer([sample(20)])
    assert thread.dropped == Tally(21, 21 * 12)  # no message had been synchronised


class FullLater(Broken):
    """Recorder as above that synchronises after each message."""

    def sync(self) -> None:
        super().sync()
        self.synchronised = sum(self._counts.values())


def test_what_was_synchronised_before_a_disk_was_full_is_not_counted_as_dropped(tmp_path: Path):
    broken = FullLater(tmp_path / "bag", Manifest())
    thread = RecordingThread(broken, sync_s=0.0, backlog_bytes=10**6)
    for i in range(10):
        thread.offer([sample(i)])
    thread.close()
    with open_bag(tmp_path / "bag", lambda _: None) as bag:
        assert bag.message_count == broken.synchronised == 2
    assert thread.dropped.messages == 8
