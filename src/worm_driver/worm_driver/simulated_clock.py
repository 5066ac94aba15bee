# SPDX-License-Identifier: Apache-2.0
"""Clients of the virtual robot's simulated clock: a memory page to read the time, a socket to wait.

The page contains the ROS time at which the clock shows 0 (int64, ns) and the clock's time (float64, s). Once a thread
has connected as a client, simulated time advances only while the thread waits. The thread requests each wait from the
server (`Wait`). The request states how many bytes the client has written to and read from the serial line. With these
counts the server stops the time while bytes are still in the pseudo-terminal, which delivers late on a busy machine.
The server reports the end of a wait by sending its number, unless bytes from the device end the wait.
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
WAKE = struct.Struct("<Q")  # number of a wait that has ended
_PAGE_SIZE = 16
_SHORTEST = 1e-6  # shortest wait, s; a shorter one would not end because of rounding
_LEAST_TIMEOUT = 60.0  # s, see `Clock.least_timeout`


@dataclass(frozen=True)
class Wait:
    """Wait request.

    Attributes:
        number: number of the wait, counted by the client.
        until: latest end, s; inf for none.
        listening: True if bytes from the device also end the wait.
        written, read: numbers of bytes that the client has written to and read from the serial line.
    """

    number: int
    until: float
    listening: bool
    written: int
    read: int

    def pack(self) -> bytes:
        """Return the packet for the socket."""
        return _WAIT.pack(self.number, self.until, self.listening, self.written, self.read)

    @staticmethod
    def unpack(packet: bytes) -> "Wait":
        """Return the wait of a packet. Raises struct.error if it is invalid."""
        return Wait(*_WAIT.unpack(packet))


class Page:
    """Simulated time in shared memory, written by one process and read by others."""

    def __init__(self, path: Path) -> None:
        """Open an existing page. Raises OSError."""
        descriptor = os.open(path, os.O_RDWR | os.O_CLOEXEC)
        try:
            memory = memoryview(mmap.mmap(descriptor, _PAGE_SIZE))
        finally:
            os.close(descriptor)
        # Aligned words are read and written atomically.
        self._epoch = memory[:8].cast("q")
        self._time = memory[8:].cast("d")

    @staticmethod
    def make(path: Path, epoch_ns: int) -> "Page":
        """Create a page at time 0. Its file appears atomically."""
        unfinished = path.with_suffix(".unfinished")
        unfinished.write_bytes(bytes(_PAGE_SIZE))
        page = Page(unfinished)
        page._epoch[0] = epoch_ns
        unfinished.rename(path)
        return page

    @property
    def epoch_ns(self) -> int:
        """ROS time at which the clock shows 0, ns."""
        return self._epoch[0]

    @property
    def time(self) -> float:
        """Time of the clock, s."""
        return self._time[0]

    @time.setter
    def time(self, value: float) -> None:
        self._time[0] = value


class SimulatedClock:
    """Client of a virtual robot's clock, for one thread; see clock.Clock.

    When the robot's process has ended, the clock continues at the machine's pace, so that no thread waits for ever.

    Args:
        directory: the robot's directory.
        port: the interface that the thread uses, SERIAL or I2C.
    """

    least_timeout = _LEAST_TIMEOUT

    def __init__(self, directory: Path, port: bytes) -> None:
        self.traffic = Traffic()
        self._page = Page(directory / PAGE_NAME)
        self.epoch_ns: int | None = self._page.epoch_ns
        self._number = 0
        self._offset = math.nan  # simulated minus machine's time, s; NaN while connected
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        try:
            self._socket.connect(str(directory / SOCKET_NAME))
            self._socket.sendall(port)
            self._await_number(0)
        except OSError:
            self._socket.close()
            raise

    def __call__(self) -> float:
        """Return the time, s."""
        if math.isnan(self._offset):
            return self._page.time
        return time.monotonic() + self._offset

    def sleep_until(self, due: float) -> None:
        """Wait until a time (s)."""
        if due > self():
            self._wait(due, None)

    def wait_readable(self, descriptor: int, timeout: float) -> bool:
        """Wait at most ``timeout`` (s) for data on a file descriptor. Return True if there is data."""
        if select.select([descriptor], [], [], 0.0)[0]:
            return True
        return timeout > 0.0 and self._wait(self() + max(timeout, _SHORTEST), descriptor)

    def close(self) -> None:
        """Disconnect; repeated calls have no effect. From then on the clock continues at the machine's pace."""
        if math.isnan(self._offset):
            self._offset = self._page.time - time.monotonic()
        self._socket.close()

    def _wait(self, until: float, descriptor: int | None) -> bool:
        """Wait until a time (s) or for data on a file descriptor (None: no file). Return True if there is data."""
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
        """Return the number of a wait that ended. Raises ConnectionError if the robot's process has ended."""
        received = self._socket.recv(WAKE.size)
        if not received:
            raise ConnectionResetError
        return int(WAKE.unpack(received)[0])

    def _wait_alone(self, until: float, descriptor: int | None) -> bool:
        if math.isnan(self._offset):
            self._offset = self._page.time - time.monotonic()
        left = max(0.0, until - self())
        return bool(select.select([] if descriptor is None else [descriptor], [], [], left)[0])


def clock_of(device: str, port: bytes) -> Clock:
    """Return the clock for a device: the virtual robot's if the device belongs to one, else the machine's.

    Any link that leads to the robot's pseudo-terminal or socket is followed.
    """
    for path in (last_link(device), os.path.realpath(device)) if device else ():
        directory = Path(path).parent
        if (directory / SOCKET_NAME).is_socket():
            with contextlib.suppress(OSError):
                return SimulatedClock(directory, port)
    return MachineClock()


def is_virtual(port: str) -> bool:
    """Return True if a serial port is the pseudo-terminal of a virtual robot, also through links."""
    return os.path.realpath(port).startswith("/dev/pts/")


def last_link(device: str) -> str:
    """Return the last link in a chain of links to a device. A device that is not a link is returned unchanged."""
    path = Path(device)
    while path.is_symlink() and (target := path.parent / path.readlink()).is_symlink():
        path = target
    return str(path.parent.resolve() / path.name)
