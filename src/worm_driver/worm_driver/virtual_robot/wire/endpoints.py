# SPDX-License-Identifier: Apache-2.0
"""The virtual robot's doors: a pseudo-terminal for the servo bus, a socket for the I2C line.

One thread owns the robot. It waits in select() and never polls, so that an answer leaves some
hundred microseconds after its question; in between it wakes up often enough for the worm to move.
"""

import contextlib
import fcntl
import heapq
import os
import selectors
import socket
import termios
import time
import tty
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from worm_driver.virtual_robot.camera import TrackerSample
from worm_driver.virtual_robot.servo.control_table import BAUD_RATES
from worm_driver.virtual_robot.virtual_robot import VirtualRobot
from worm_driver.virtual_robot.wire import faults
from worm_driver.virtual_robot.wire import smbus_frames as frames
from worm_driver.virtual_robot.wire.faults import Fault

SERIAL_NAME = "servo_bus"
I2C_NAME = "i2c.sock"

_LOCK_NAME = ".virtual_robot.lock"
_WAKE_UP = 0.004  # s at most between two looks at the clock
_CHUNK = 4096  # bytes

# pyserial puts the rate into the terminal's settings, where the other end can read it.
_SPEEDS = {
    getattr(termios, f"B{rate}"): rate for rate in BAUD_RATES if hasattr(termios, f"B{rate}")
}


class DirectoryError(Exception):
    """A directory that cannot be used; the message says why and what to do."""


class SerialDoor:
    """A pseudo-terminal with a symbolic link to its far end."""

    def __init__(self, link: Path) -> None:
        self._link = link
        self.master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self.master, False)
        # The slave stays open here: otherwise the master fails while no client has it open.
        link.symlink_to(os.ttyname(self._slave))

    def baud_rate(self) -> int:
        """The rate (bit/s) that the client has set; 0 if it is none of a servo's."""
        return _SPEEDS.get(termios.tcgetattr(self._slave)[5], 0)

    def read(self) -> bytes:
        """What has arrived."""
        return os.read(self.master, _CHUNK)

    def write(self, data: bytes) -> None:
        """Sends; what a client that does not read leaves no room for is lost, as on a wire."""
        with contextlib.suppress(BlockingIOError):
            os.write(self.master, data)

    def close(self) -> None:
        """Takes the port away from whoever has it open."""
        self._link.unlink(missing_ok=True)
        os.close(self.master)
        os.close(self._slave)


class I2cConnection:
    """One client of the socket."""

    def __init__(self, connection: socket.socket) -> None:
        self.socket = connection
        self._buffer = b""

    def read(self) -> list[frames.Request]:
        """The requests that have arrived. Raises ConnectionError when the client is gone."""
        received = self.socket.recv(_CHUNK)
        if not received:
            raise ConnectionResetError
        self._buffer += received
        requests: list[frames.Request] = []
        while True:
            request, self._buffer = frames.take_request(self._buffer)
            if request is None:
                return requests
            requests.append(request)

    def write(self, data: bytes) -> None:
        """Sends an answer; a client that has gone gets none."""
        with contextlib.suppress(OSError):
            self.socket.sendall(data)


@dataclass(order=True)
class _Pending:
    """Bytes that leave later."""

    time: float
    order: int
    data: bytes = field(compare=False)
    door: "SerialDoor | I2cConnection" = field(compare=False)


class Endpoints:
    """Serves a robot in a directory; open(), run() in a thread, stop() from any other, close().

    on_samples: called in the serving thread with samples of the camera that have become available.
    """

    def __init__(
        self,
        robot: VirtualRobot,
        directory: Path,
        on_samples: Callable[[list[TrackerSample]], None],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._robot = robot
        self._directory = directory
        self._on_samples = on_samples
        self._clock = clock
        self._start = clock()
        self._selector = selectors.SelectSelector()  # epoll would round waits up to 1 ms
        self._serial: SerialDoor | None = None
        self._listener: socket.socket | None = None
        self._pending: list[_Pending] = []
        self._sent = 0
        self._orders: deque[Callable[[float], None]] = deque()
        self._stopped = False
        self._wake_reader, self._wake_writer = socket.socketpair()

    def now(self) -> float:
        """Time (s) on the robot's clock."""
        return self._clock() - self._start

    # --- life ---------------------------------------------------------------------------------

    def open(self) -> None:
        """Takes the directory and opens both doors. Raises DirectoryError."""
        self._lock = _take(self._directory)
        try:
            for name in (SERIAL_NAME, I2C_NAME):
                _remove_leftover(self._directory / name)
            self._listener = _listen(self._directory / I2C_NAME)
        except DirectoryError:
            self._give_back()
            raise
        self._selector.register(self._listener, selectors.EVENT_READ, self._on_connect)
        self._plug_in()
        self._selector.register(self._wake_reader, selectors.EVENT_READ, self._on_wake)
        self._start = self._clock()

    def run(self) -> None:
        """Serves until stop()."""
        while not self._stopped:
            for key, _ in self._selector.select(self._until_next()):
                key.data()
            self._robot.advance(self.now())
            self._follow_plug()
            self._send_due()
            samples = self._robot.take_samples(self.now())
            if samples:
                self._on_samples(samples)

    def stop(self) -> None:
        """Ends run(); from any thread."""
        self._stopped = True
        self._wake_writer.send(b"x")

    def inject(self, fault: Fault) -> None:
        """Asks for a fault whose start counts from now; from any thread."""
        self._order(lambda now: self._robot.board.add(fault.delayed(now)))

    def clear_faults(self) -> None:
        """Ends all faults; from any thread."""
        self._order(lambda _: self._robot.board.clear())

    def close(self) -> None:
        """Removes what open() made, once run() is over; may be repeated."""
        if self._listener is None:
            return
        if self._serial is not None:
            self._serial.close()
        for key in list(self._selector.get_map().values()):
            if isinstance(key.fileobj, socket.socket):  # the listener, its clients, the wake-up
                key.fileobj.close()
        self._selector.close()
        self._wake_writer.close()
        self._serial = self._listener = None
        (self._directory / I2C_NAME).unlink(missing_ok=True)
        self._give_back()

    def _give_back(self) -> None:
        (self._directory / _LOCK_NAME).unlink(missing_ok=True)
        os.close(self._lock)

    # --- events -------------------------------------------------------------------------------

    def _until_next(self) -> float:
        wait = _WAKE_UP
        if self._pending:
            wait = min(wait, self._pending[0].time - self.now())
        return max(wait, 0.0)

    def _on_wake(self) -> None:
        self._wake_reader.recv(_CHUNK)
        while self._orders:
            self._orders.popleft()(self.now())

    def _order(self, order: Callable[[float], None]) -> None:
        self._orders.append(order)
        self._wake_writer.send(b"x")

    def _on_serial(self) -> None:
        if self._serial is None:
            return
        rate = self._serial.baud_rate()
        for answer in self._robot.receive(self._serial.read(), self.now(), rate):
            self._send(answer.data, answer.time, self._serial)

    def _on_connect(self) -> None:
        if self._listener is None:
            return
        connection = I2cConnection(self._listener.accept()[0])
        self._selector.register(
            connection.socket, selectors.EVENT_READ, lambda: self._on_i2c(connection)
        )

    def _on_i2c(self, connection: I2cConnection) -> None:
        try:
            requests = connection.read()
        except ConnectionError:
            self._selector.unregister(connection.socket)
            connection.socket.close()
            return
        for request in requests:
            now = self.now()
            answer = self._robot.transact(request, now)
            self._send(frames.pack_answer(answer), now + answer.delay, connection)

    def _send(self, data: bytes, due: float, door: "SerialDoor | I2cConnection") -> None:
        if due <= self.now():
            door.write(data)
            return
        self._sent += 1
        heapq.heappush(self._pending, _Pending(due, self._sent, data, door))

    def _send_due(self) -> None:
        now = self.now()
        while self._pending and self._pending[0].time <= now:
            item = heapq.heappop(self._pending)
            item.door.write(item.data)

    # --- doors --------------------------------------------------------------------------------

    def _plug_in(self) -> None:
        self._serial = SerialDoor(self._directory / SERIAL_NAME)
        self._selector.register(self._serial.master, selectors.EVENT_READ, self._on_serial)

    def _follow_plug(self) -> None:
        """Closes the serial port while its fault lasts."""
        unplugged = self._robot.board.active(faults.UNPLUGGED, self.now()) is not None
        if unplugged and self._serial is not None:
            self._selector.unregister(self._serial.master)
            self._pending = [item for item in self._pending if item.door is not self._serial]
            heapq.heapify(self._pending)
            self._serial.close()
            self._serial = None
        elif not unplugged and self._serial is None:
            self._plug_in()


def _take(directory: Path) -> int:
    """A lock on a directory, made if need be, that ends with the process."""
    try:
        directory.mkdir(parents=True, exist_ok=True)
        lock = os.open(directory / _LOCK_NAME, os.O_CREAT | os.O_RDWR | os.O_CLOEXEC, 0o600)
    except OSError as error:
        raise DirectoryError(
            f"{directory}: {error.strerror}: choose another --directory"
        ) from error
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        os.close(lock)
        raise DirectoryError(
            f"{directory} is in use by another virtual robot: stop it or choose another --directory"
        ) from error
    return lock


def _listen(path: Path) -> socket.socket:
    """A socket that waits for clients of the I2C line."""
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        listener.bind(str(path))
    except OSError as error:
        listener.close()
        raise DirectoryError(
            f"{path.parent}: no socket there ({error}): choose a shorter --directory"
        ) from error
    listener.listen()
    return listener


def _remove_leftover(path: Path) -> None:
    """Removes what a robot that was killed left there, and nothing else."""
    if path.is_symlink() or path.is_socket():
        path.unlink()
    elif path.exists():
        raise DirectoryError(f"{path} is in the way: move it or choose another --directory")
