# SPDX-License-Identifier: Apache-2.0
"""Server of the virtual robot: a pseudo-terminal for the servo bus, sockets for I2C and clock.

One thread owns the robot. It waits in select(), so that an answer leaves some hundred microseconds after its request,
and wakes up regularly to advance the plant. With clients of its clock (simulated_clock), simulated time advances from
event to event and waits for clients that are late. Without clients, simulated time advances at the rate ``rate`` of
`RobotServer`, or in real time if ``rate`` is inf or None.
"""

import contextlib
import fcntl
import heapq
import math
import os
import selectors
import socket
import struct
import termios
import time
import tty
from collections import deque
from collections.abc import Callable
from pathlib import Path

from worm_driver import simulated_clock
from worm_driver.power import socket_smbus as frames
from worm_driver.virtual_robot.servo.control_table import BAUD_RATES
from worm_driver.virtual_robot.virtual_robot import TrackerSample, VirtualRobot
from worm_driver.virtual_robot.wire.clock_server import ClockClient, ClockServer
from worm_driver.virtual_robot.wire.faults import Fault
from worm_msgs.input_error import InputError

SERIAL_NAME = "servo_bus"
I2C_NAME = "i2c.sock"

_LOCK_NAME = ".virtual_robot.lock"
_WAKE_UP = 0.004  # s; longest time between two updates of the robot
_COMPUTING_PERIOD = 0.1  # s of machine time; time between two updates while a client computes
_CHUNK = 4096  # bytes that are read at once

# pyserial stores the baud rate in the terminal's settings, where the other end can read it.
_SPEEDS = {
    getattr(termios, f"B{rate}"): rate for rate in BAUD_RATES if hasattr(termios, f"B{rate}")
}


class DirectoryError(InputError):
    """The directory cannot be used. The message contains reason and remedy."""


class PtyPort:
    """Pseudo-terminal with a symbolic link to its client side."""

    def __init__(self, link: Path) -> None:
        self._link = link
        self.master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self.master, False)
        # The server keeps the slave open, because the master fails if no process has the slave open.
        link.symlink_to(os.ttyname(self._slave))

    def baud_rate(self) -> int:
        """Return the client's baud rate (bit/s); 0 if servos do not support it."""
        return _SPEEDS.get(termios.tcgetattr(self._slave)[5], 0)

    def read(self) -> bytes:
        """Return the received bytes."""
        return os.read(self.master, _CHUNK)

    def send(self, data: bytes) -> None:
        """Send bytes. Raises BlockingIOError if the client does not read and the buffer is full."""
        os.write(self.master, data)

    def close(self) -> None:
        """Close the port, also for its clients."""
        self._link.unlink(missing_ok=True)
        os.close(self.master)
        os.close(self._slave)


Port = PtyPort | socket.socket


class RobotServer:
    """Server of a robot in a directory: open(), run() in a thread, stop() from any other thread, close().

    Args:
        robot: the robot to serve.
        directory: directory of the pseudo-terminal and the sockets.
        on_samples: called in the serving thread with new camera samples.
        rate: largest ratio of simulated to machine time; inf for as fast as the clients allow; None for real time
            that never waits for clients, as with a real robot.
        epoch_ns: ROS time at the robot's time 0, ns.
        on_time: called in the serving thread with the robot's time (s) at each update.

    Attributes:
        shares_time: True if clients can use the robot's clock; False if ``rate`` is None.
        time: simulated time and its rate.
    """

    def __init__(
        self,
        robot: VirtualRobot,
        directory: Path,
        on_samples: Callable[[list[TrackerSample]], None],
        rate: float | None = 1.0,
        epoch_ns: int = 0,
        on_time: Callable[[float], None] = lambda _: None,
    ) -> None:
        self._on_time = on_time
        self._robot = robot
        self._directory = directory
        self._on_samples = on_samples
        self._clock = time.monotonic
        self.epoch_ns = epoch_ns
        self.shares_time = rate is not None
        self.time = ClockServer(1.0 if rate is None else rate)
        self.time.begin(self._clock())
        self._page: simulated_clock.Page | None = None
        self._clients: dict[socket.socket, ClockClient] = {}  # clients of the clock
        # Numbers of bytes sent and received on the serial line since a client connected. After `_cut_line` they are
        # -inf and inf, so that no wait depends on them.
        self._bytes_sent = self._bytes_received = 0.0
        self._selector = selectors.SelectSelector()  # epoll would round timeouts up to 1 ms
        self._serial: PtyPort | None = None
        self._opened = False
        # Heap of bytes to send later: time, number of the entry, bytes and port.
        self._pending: list[tuple[float, int, bytes, Port]] = []
        self._sent = 0
        self._commands: deque[Callable[[float], None]] = deque()
        self._stopped = False
        self._last_received = -math.inf  # machine's clock, s
        self._wake_reader, self._wake_writer = socket.socketpair()

    def now(self) -> float:
        """Return the time (s) on the robot's clock."""
        return self.time.now if self._clients else self.time.alone(self._clock())

    # --- life ---------------------------------------------------------------------------------

    def open(self) -> None:
        """Lock the directory and create the devices. Raises DirectoryError."""
        self._lock = _lock_directory(self._directory)
        try:
            for name in (SERIAL_NAME, I2C_NAME, simulated_clock.SOCKET_NAME):
                _remove_leftover(self._directory / name)
            self._listen(I2C_NAME, self._on_i2c)
            if self.shares_time:
                self._page = simulated_clock.Page.make(
                    self._directory / simulated_clock.PAGE_NAME, self.epoch_ns
                )
                self._listen(simulated_clock.SOCKET_NAME, self._on_clock)
        except DirectoryError:
            self._unlock()
            raise
        self._opened = True
        self._plug_in()
        self._selector.register(self._wake_reader, selectors.EVENT_READ, self._on_wake)
        self.time.begin(self._clock())

    def run(self) -> None:
        """Serve until stop() is called."""
        while not self._stopped:
            for key, _ in self._selector.select(self._time_to_update()):
                key.data()
            self._robot.advance(self._advance_time())
            self._follow_plug()
            self._send_due()
            self._on_time(self.now())
            self._wake_due()
            if samples := self._robot.take_samples():
                self._on_samples(samples)

    def stop(self) -> None:
        """End run(). Safe in any thread."""
        self._stopped = True
        self._wake_writer.send(b"x")

    def is_unused(self, duration: float) -> bool:
        """Return True if the clock has no client and the servo bus was silent for a duration (s of machine time).

        On a busy computer, a driver that returns to rest may be silent for longer. Safe in any thread.
        """
        return not self._clients and self._clock() - self._last_received > duration

    def inject(self, fault: Fault) -> None:
        """Inject a fault whose start is relative to the present time. Safe in any thread."""
        self._submit(lambda now: self._robot.board.add(fault.delayed(now)))

    def clear_faults(self) -> None:
        """End all faults. Safe in any thread."""
        self._submit(lambda _: self._robot.board.clear())

    def close(self) -> None:
        """Remove the devices that open() created. Call this after run() has ended; repeated calls have no effect."""
        if not self._opened:
            return
        self._opened = False
        if self._serial is not None:
            self._serial.close()
        for key in list(self._selector.get_map().values()):
            # The sockets are those of the listeners, of their clients and of the wake-up.
            if isinstance(key.fileobj, socket.socket):
                key.fileobj.close()
        self._selector.close()
        self._wake_writer.close()
        self._serial = None
        for name in (I2C_NAME, simulated_clock.SOCKET_NAME, simulated_clock.PAGE_NAME):
            (self._directory / name).unlink(missing_ok=True)
        self._unlock()

    def _unlock(self) -> None:
        (self._directory / _LOCK_NAME).unlink(missing_ok=True)
        os.close(self._lock)

    # --- events -------------------------------------------------------------------------------

    def _advance_time(self) -> float:
        """Advance simulated time as far as allowed and return it."""
        machine, clients = self._clock(), self._clients.values()
        sent, received = self._bytes_sent, self._bytes_received
        if any(client.has_lost_bytes(machine, sent, received) for client in clients):
            self._cut_line()
        if clients:
            waiting = (p.waits(self._bytes_sent, self._bytes_received) for p in clients)
            now = self.time.together(machine, waiting, self._next_event())
        else:
            now = self.time.alone(machine)
        self._show(now)
        return now

    def _show(self, now: float) -> None:
        if self._page is not None:
            self._page.time = now

    def _next_event(self) -> float:
        """Return the time (s) of the next event. Simulated time must not advance past it."""
        dues = [client.wait.until for client in self._clients.values() if client.wait is not None]
        dues += [due for due, *_ in self._pending[:1]]
        return min([*dues, self.time.now + _WAKE_UP])

    def _time_to_update(self) -> float:
        """Return the time (s of machine time) until the next update, if no data arrives."""
        machine, clients = self._clock(), self._clients.values()
        if not clients:
            wait = _WAKE_UP
            if self._pending:
                wait = min(wait, self._pending[0][0] - self.now())
            return max(wait, 0.0)
        if all(p.waits(self._bytes_sent, self._bytes_received) for p in clients):
            return max(self.time.machine_time(self._next_event()) - machine, 0.0)
        return _COMPUTING_PERIOD

    def _wake_due(self) -> None:
        """End the waits that are due."""
        now = self.time.now
        for connection, client in self._clients.items():
            if client.wait is None or client.wait.until > now:
                continue
            if client.waits(self._bytes_sent, self._bytes_received):
                number, client.wait = client.wait.number, None
                _send(connection, simulated_clock.WAKE.pack(number))

    def _on_wake(self) -> None:
        self._wake_reader.recv(_CHUNK)
        while self._commands:
            self._commands.popleft()(self.now())

    def _submit(self, command: Callable[[float], None]) -> None:
        self._commands.append(command)
        self._wake_writer.send(b"x")

    def _on_serial(self) -> None:
        if self._serial is None:
            return
        rate, data = self._serial.baud_rate(), self._serial.read()
        self._bytes_received += len(data)
        self._last_received = self._clock()
        for answer in self._robot.receive(data, self.now(), rate):
            self._send(answer.data, answer.time, self._serial)

    def _on_i2c(self, connection: socket.socket) -> None:
        try:
            request = frames.unpack_request(_received(connection))
        except (ConnectionError, struct.error):
            self._disconnect(connection)
            return
        now = self.now()
        answer = self._robot.transact(request, now)
        if answer.delay > 0.0:
            self._await_delayed_answer(simulated_clock.I2C)
        self._send(frames.pack_answer(answer), now + answer.delay, connection)

    def _send(self, data: bytes, due: float, port: Port) -> None:
        if due <= self.now():
            self._write(data, port)
            return
        self._sent += 1
        heapq.heappush(self._pending, (due, self._sent, data, port))

    def _send_due(self) -> None:
        now = self.now()
        while self._pending and self._pending[0][0] <= now:
            _, _, data, port = heapq.heappop(self._pending)
            self._write(data, port)

    def _write(self, data: bytes, port: Port) -> None:
        """Send bytes, and end the waits of the clients that wait for bytes from this port."""
        _send(port, data)
        is_serial = isinstance(port, PtyPort)
        self._bytes_sent += len(data) if is_serial else 0
        for client in self._clients.values():
            at_port = client.port == (simulated_clock.SERIAL if is_serial else simulated_clock.I2C)
            if at_port and client.wait is not None and client.wait.listening:
                client.wait = None

    # --- the time -----------------------------------------------------------------------------

    def _on_clock(self, connection: socket.socket) -> None:
        """Process a packet of a clock client. The first packet names its interface; each later one requests a wait."""
        try:
            packet = _received(connection)
            client = self._clients.get(connection)
            if client is not None:
                client.wait, client.since = simulated_clock.Wait.unpack(packet), self._clock()
                return
        except (ConnectionError, struct.error):
            self._clients.pop(connection, None)
            self._disconnect(connection)
            if not self._clients:
                self.time.begin(self._clock())
            return
        self._show(self.now())  # The client reads the time as soon as it is connected.
        self._clients[connection] = ClockClient(packet)
        _send(connection, simulated_clock.WAKE.pack(0))
        if packet == simulated_clock.SERIAL:
            self._begin_line()

    def _begin_line(self) -> None:
        """Reset the byte counts and drop bytes in transit to an earlier client."""
        self._bytes_sent = self._bytes_received = 0.0
        self._drop_pending()

    def _drop_pending(self) -> None:
        self._pending = [item for item in self._pending if item[3] is not self._serial]
        heapq.heapify(self._pending)

    def _cut_line(self) -> None:
        """Stop counting bytes, because simulated time must not wait for bytes that no client will receive."""
        self._bytes_sent, self._bytes_received = -math.inf, math.inf

    def _await_delayed_answer(self, port: bytes) -> None:
        """Mark the clients of an interface as waiting for its delayed answer."""
        for client in self._clients.values():
            if client.port == port:
                client.wait, client.since = (
                    simulated_clock.Wait(-1, math.inf, True, 0, 0),
                    self._clock(),
                )

    # --- ports --------------------------------------------------------------------------------

    def _listen(self, name: str, serve: Callable[[socket.socket], None]) -> None:
        """Accept clients on a socket. Raises DirectoryError."""
        listener = _listening(self._directory / name)

        def accept() -> None:
            client = listener.accept()[0]
            self._selector.register(client, selectors.EVENT_READ, lambda: serve(client))

        self._selector.register(listener, selectors.EVENT_READ, accept)

    def _disconnect(self, connection: socket.socket) -> None:
        self._selector.unregister(connection)
        connection.close()

    def _plug_in(self) -> None:
        self._serial = PtyPort(self._directory / SERIAL_NAME)
        self._selector.register(self._serial.master, selectors.EVENT_READ, self._on_serial)

    def _follow_plug(self) -> None:
        """Close the serial port when a fault unplugs it, and open it again when the fault ends."""
        unplugged = self._robot.board.active("unplugged", self.now()) is not None
        if unplugged and self._serial is not None:
            self._selector.unregister(self._serial.master)
            self._drop_pending()
            self._serial.close()
            self._serial = None
            self._cut_line()
        elif not unplugged and self._serial is None:
            self._plug_in()


def _lock_directory(directory: Path) -> int:
    """Create a directory if necessary, lock it and return the lock's descriptor. The lock ends with the process."""
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
            f"{directory} is in use by another virtual robot: stop it, or choose another --directory "
            "(of ./worm start: --set directory=PATH)"
        ) from error
    return lock


def _received(connection: socket.socket) -> bytes:
    """Return the next packet of a client. Raises ConnectionError if the client has disconnected."""
    packet = connection.recv(_CHUNK)
    if not packet:
        raise ConnectionResetError
    return packet


def _send(port: Port, data: bytes) -> None:
    """Send bytes. They are lost if the client's buffer is full, as on a bus, or if the client has disconnected."""
    with contextlib.suppress(OSError):
        port.send(data)


def _listening(path: Path) -> socket.socket:
    """Return a listening socket that preserves packets. Raises DirectoryError."""
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    try:
        listener.bind(str(path))
    except OSError as error:
        listener.close()
        raise DirectoryError(
            f"{path.parent}: cannot create a socket ({error}): choose a shorter --directory"
        ) from error
    listener.listen()
    return listener


def _remove_leftover(path: Path) -> None:
    """Remove a file that a killed robot left behind. Raises DirectoryError for any other file."""
    if path.is_symlink() or path.is_socket():
        path.unlink()
    elif path.exists():
        raise DirectoryError(f"{path} is in the way: move it or choose another --directory")
