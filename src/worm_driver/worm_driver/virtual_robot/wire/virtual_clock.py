# SPDX-License-Identifier: Apache-2.0
"""The virtual robot's time, as seen from other processes: a page to read it from, a socket to wait on.

The page holds the ROS time of the clock's zero (int64, ns) and the time (float64, s). A thread that connects takes
part: the time stands from then on unless the thread waits. A wait names its number, how long it lasts at most, whether
bytes from the door end it, and how many bytes the thread has written to and read from the serial line: a
pseudo-terminal carries them late when the machine is busy, and no time may pass while any are on their way. The end
of a wait by time is told with its number; bytes that end it tell it by themselves.
"""

import contextlib
import math
import mmap
import os
import select
import socket
import struct
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from worm_driver.clock import Clock, MachineClock, Traffic

SOCKET_NAME: Final = "clock.sock"
PAGE_NAME: Final = "clock"

SERIAL: Final = b"S"
I2C: Final = b"I"

_WAIT = struct.Struct("<Qd?QQ")
WAKE = struct.Struct("<Q")  # the number of a wait that has ended
_PAGE_SIZE = 16
_SHORTEST = 1e-6  # s, of a wait: shorter ones would not end for rounding
_PATIENCE = 60.0  # s


@dataclass(frozen=True)
class Wait:
    """See the module. ``until`` in s, inf for as long as it takes."""

    number: int
    until: float
    listening: bool
    written: int
    read: int

    def pack(self) -> bytes:
        """As it goes over the socket."""
        return _WAIT.pack(self.number, self.until, self.listening, self.written, self.read)

    @staticmethod
    def unpack(packet: bytes) -> "Wait":
        """From what has gone over the socket. Raises struct.error where it is no wait."""
        return Wait(*_WAIT.unpack(packet))


class Page:
    """The time in shared memory; written by one process, read by others."""

    def __init__(self, path: Path) -> None:
        """Opens a page that is there. Raises OSError."""
        descriptor = os.open(path, os.O_RDWR | os.O_CLOEXEC)
        try:
            memory = memoryview(mmap.mmap(descriptor, _PAGE_SIZE))
        finally:
            os.close(descriptor)
        # Aligned words: each is read and written in one piece.
        self._epoch = memory[:8].cast("q")
        self._time = memory[8:].cast("d")

    @staticmethod
    def make(path: Path, epoch_ns: int) -> "Page":
        """A new page at time 0, whole from the moment on at which it is there."""
        unfinished = path.with_suffix(".unfinished")
        unfinished.write_bytes(bytes(_PAGE_SIZE))
        page = Page(unfinished)
        page._epoch[0] = epoch_ns
        unfinished.rename(path)
        return page

    @property
    def epoch_ns(self) -> int:
        """The ROS time of the clock's zero, ns."""
        return self._epoch[0]

    @property
    def time(self) -> float:
        """Since the clock's zero, s."""
        return self._time[0]

    @time.setter
    def time(self, value: float) -> None:
        self._time[0] = value


class VirtualClock:
    """Takes part in a virtual robot's time, for one thread at a time; see clock.Clock.

    Once the robot is gone its time goes on as the machine's does, so that nobody waits for ever.

    The thread works with a door of the robot in a directory, SERIAL or I2C. Raises OSError where there is no clock.
    """

    patience = _PATIENCE

    def __init__(self, directory: Path, door: bytes) -> None:
        self.traffic = Traffic()
        self._page = Page(directory / PAGE_NAME)
        self.epoch_ns: int | None = self._page.epoch_ns
        self._number = 0
        self._offset = math.nan  # s, from the machine's time to this one, once the robot is gone
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        try:
            self._socket.connect(str(directory / SOCKET_NAME))
            self._socket.sendall(door)
            self._await_number(0)
        except OSError:
            self._socket.close()
            raise

    def __call__(self) -> float:
        """Now."""
        if math.isnan(self._offset):
            return self._page.time
        return time.monotonic() + self._offset

    def sleep_until(self, due: float) -> None:
        """Returns at a time (s)."""
        if due > self():
            self._wait(due, None)

    def wait_readable(self, descriptor: int, timeout: float) -> bool:
        """Waits for something to read from a file for at most a time (s); whether there is."""
        if select.select([descriptor], [], [], 0.0)[0]:
            return True
        return timeout > 0.0 and self._wait(self() + max(timeout, _SHORTEST), descriptor)

    def close(self) -> None:
        """Takes part no longer; may be repeated. From then on the time goes on as the machine's does."""
        if math.isnan(self._offset):
            self._offset = self._page.time - time.monotonic()
        self._socket.close()

    def _wait(self, until: float, descriptor: int | None) -> bool:
        """Whether the file has something to read."""
        self._number += 1
        traffic = self.traffic
        listening = descriptor is not None
        wait = Wait(self._number, until, listening, traffic.written, traffic.read)
        with contextlib.suppress(OSError):
            self._socket.sendall(wait.pack())
            if descriptor is None:
                self._await_number(self._number)
                return False
            sources: list[Any] = [descriptor, self._socket]
            while True:
                ready = select.select(sources, [], [])[0]
                if descriptor in ready:
                    return True
                if self._take_number() == self._number:
                    return False
        return self._wait_alone(until, descriptor)

    def _await_number(self, number: int) -> None:
        while self._take_number() != number:
            pass

    def _take_number(self) -> int:
        """Raises ConnectionError when the robot is gone."""
        received = self._socket.recv(WAKE.size)
        if not received:
            raise ConnectionResetError
        return int(WAKE.unpack(received)[0])

    def _wait_alone(self, until: float, descriptor: int | None) -> bool:
        if math.isnan(self._offset):
            self._offset = self._page.time - time.monotonic()
        left = max(0.0, until - self())
        return bool(select.select([] if descriptor is None else [descriptor], [], [], left)[0])


def clock_of(device: str, door: bytes) -> Clock:
    """The clock for the thread of a device: that of the virtual robot which the device belongs to, or the machine's."""
    directory = Path(device).parent
    if not device or not (directory / SOCKET_NAME).is_socket():
        return MachineClock()
    with contextlib.suppress(OSError):
        return VirtualClock(directory, door)
    return MachineClock()
