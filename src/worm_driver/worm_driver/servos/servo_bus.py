# SPDX-License-Identifier: Apache-2.0
"""Servo bus: Dynamixel Protocol 2.0 through dynamixel_sdk. No other module imports that package.

This module corrects the following defects of version 4.1.0 of the SDK:

- The SDK computes a packet with byte stuffing (e-manual, Protocol 2.0, "Byte stuffing"), but sends the packet without
  stuffing. When it removes stuffing, it overwrites bytes before it reads them. See ``_PacketHandler``.
- The SDK measures timeouts by the wall clock, spins while it waits, and never stops reading while bytes arrive. See
  ``BusPort``.
- The SDK mistakes a late answer for the answer to the next request. In this module, an answer must have the requested
  length, and the next request after a missing or unusable answer waits for a quiet line, on which no late answer can
  arrive. (An answer with an error number is complete, so the next request does not wait.) In addition, ``tick_clock``
  compares the servo's clock in an answer with the time of the request, and detects answers that are too old.
- The SDK's timeout expires even if received bytes are unread. This module first reads such bytes, which exist for
  example after the process was suspended. See ``BusPort.expects``.
- The SDK's GroupSyncRead drops error and alert bytes, and all answers if one answer is missing. The class also accepts
  an answer with another servo's id. See ``sync_read`` and ``_attempt``.
- The SDK's busy flag stays set after an exception, and is not a lock. See ``_exchange``.
- The SDK opens a port that another program uses. See ``BusPort.setupPort``.
"""

import contextlib
import errno
import math
import os
import re
import select
import struct
import termios
import threading
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import serial
from dynamixel_sdk import COMM_SUCCESS, COMM_TX_FAIL, PortHandler, Protocol2PacketHandler

from worm_driver.clock import Clock, MachineClock
from worm_driver.driver_errors import (
    BusError,
    ConfigurationError,
    CorruptReplyError,
    NoReplyError,
    PortError,
    StatusError,
)
from worm_driver.servos import serial_port
from worm_driver.servos.registers import COMMON, Register

_ERROR_TEXT = {
    1: "could not carry the instruction out",
    2: "does not support the instruction",
    3: "received a garbled request (wrong CRC): check its cable",
    4: "rejects the value: out of range, or its bus watchdog has expired",
    5: "rejects the length of the data",
    6: "rejects the value: beyond its limit register",
    7: "rejects the access (read-only, undefined, or EEPROM while torque is on)",
}


@dataclass(frozen=True)
class Identity:
    """Answer of a servo to a ping."""

    model_number: int
    firmware: int


@dataclass(frozen=True)
class Reply:
    """Answer of one servo to a request (status packet).

    Attributes:
        data: bytes of the requested registers, in the order of their addresses; empty after a write.
        alert: True if the servo reports a hardware error (see hardware_error_status).
        error: error number of the status packet, 0 for none.
        received: time at which the driver had read the whole packet, s, monotonic.
    """

    data: bytes
    alert: bool
    error: int
    received: float = field(compare=False)  # The same answer may arrive twice.


@dataclass(frozen=True)
class BusCounters:
    """Numbers of exchanges and of failures since the port was opened.

    Attributes:
        exchanges: requests to servos, including group writes and broadcasts, which have no answer.
        timeouts: requests to one servo without an answer, and sync reads in which a usable answer is missing.
        corrupt: garbled or contradictory answers, and answers of a wrong length; in sync reads also answers of servos
            that were not requested.
        errors: answers with an error number.
        stale: answers that are older than their request.
        implausible: positions that their servo cannot have reached.
        withheld: goals that were not written because they are out of bounds.
        retries: repetitions of requests to a single servo.
    """

    exchanges: int = 0
    timeouts: int = 0
    corrupt: int = 0
    errors: int = 0
    stale: int = 0
    implausible: int = 0
    withheld: int = 0
    retries: int = 0


def error_text(number: int) -> str:
    """Return the meaning of a status packet's error number."""
    return _ERROR_TEXT.get(number, f"answers with error number {number}")


BROADCAST = 254
_PING, _READ, _WRITE, _REBOOT, _SYNC_READ, _SYNC_WRITE = 0x01, 0x02, 0x03, 0x08, 0x82, 0x83
_HEADER = b"\xff\xff\xfd"  # first three bytes of a packet; the fourth is 0

#: Remedies, by what the bus received from a servo. Each text names all causes that the observation permits.
_SILENCE_REMEDY = (
    "check its power, its cable, its id and the baud rate (of a virtual robot: that it runs, and that no fault was "
    "injected)"
)
_SHARED_ID = "that no other servo has its id (connect one servo after the other)"
_LATE_REMEDY = "check the latency timer of the adapter and the load of the computer"
#: Time for which a late answer explains a missing one, s.
_REMEMBERED = 1.0
#: Head of a status packet: header, reserved byte, id, length, instruction.
_STATUS = re.compile(rb"\xff\xff\xfd\x00(.)..\x55", re.DOTALL)

#: Timeout of a write, s. A write of pyserial would wait forever for an adapter that accepts no bytes.
_WRITE_TIMEOUT = 0.05
#: Largest number of repetitions of a failed exchange during setup.
_SETUP_RETRIES = 8
#: Largest delay of an answer during setup, s. It is shorter than the servos' bus watchdog.
_LATEST = 0.06
#: Largest number of bytes that are read after the timeout of a request. The answers to one request have fewer bytes.
_LEFT_OVER = 4096
# Indices of a packet's fields. Stuffing covers the fields from the instruction on, without the CRC.
_ID, _LENGTH, _INSTRUCTION, _ERROR, _PARAMETERS = 4, 5, 7, 8, 9
_ALERT = 0x80
#: Data of the answer to a ping: model number and firmware version.
_IDENTITY = struct.Struct("<HB")
#: Address and size of a block of the control table.
_BLOCK = struct.Struct("<HH")
#: Longest time per id that the servos take to answer a ping of all servos, s (DynamixelSDK, broadcastPing).
_PING_SLOT = 3e-3


class BusPort(PortHandler):
    """The SDK's port with monotonic time, sleeping waits and exclusive access.

    Attributes:
        latency: longest time that the adapter delays an answer, s.
    """

    def __init__(self, path: str, baud_rate: int):
        super().__init__(path)
        self.is_open = False
        self.baudrate = baud_rate
        self.latency = 0.001
        self._clock: Clock = MachineClock()
        self._left_over = 0

    def go_by(self, clock: Clock) -> None:
        """Set the clock of the thread that uses the port. Call this method before the first exchange."""
        self._clock = clock

    def getCurrentTime(self) -> float:  # noqa: N802 (the SDK's name)
        """Return the monotonic time, ms. A step of the wall clock does not change it."""
        return self._clock() * 1e3

    def setPacketTimeout(self, packet_length: int) -> None:  # noqa: N802
        """Start the timeout for an answer of a length (bytes)."""
        self.begin_wait(self.answer_time(packet_length))

    def begin_wait(self, duration: float) -> None:
        """Start a timeout of a duration (s)."""
        self._left_over = _LEFT_OVER
        self.setPacketTimeoutMillis(duration * 1e3)

    def answer_time(self, packet_length: int) -> float:
        """Return how long (s) an answer of a length (bytes) may take: transmission, twice the latency, and 2 ms."""
        return self.tx_time_per_byte * packet_length * 1e-3 + self.quiet_time

    @property
    def remaining(self) -> float:
        """Time that is left of the timeout, s; 0 after it has expired."""
        return max(0.0, self.packet_timeout - self.getTimeSinceStart()) * 1e-3

    @property
    def expects(self) -> bool:
        """True until the timeout expires.

        After the timeout, True while received bytes are unread (at most _LEFT_OVER bytes), for example because the
        process was suspended.
        """
        return self.remaining > 0.0 or (self._left_over > 0 and self._wait(0.0))

    def isPacketTimeout(self) -> bool:  # noqa: N802
        """Return True if the timeout has expired."""
        return self.remaining <= 0.0

    @property
    def quiet_time(self) -> float:
        """Duration of silence after which no late answer can arrive, s."""
        return 2 * self.latency + 2e-3

    def readPort(self, length: int) -> bytes:  # noqa: N802
        """Return at most ``length`` bytes. Sleep until some are available or the timeout expires."""
        remaining = self.remaining
        if length <= 0 or self._left_over <= 0 or not self._wait(remaining):
            return b""
        data = self._read(length)
        if remaining <= 0.0:
            self._left_over -= len(data)
        return data

    def writePort(self, packet: Sequence[int]) -> int:  # noqa: N802
        """Send all bytes and return their number."""
        left = memoryview(bytes(packet))
        device = self.ser.fileno()
        while left:
            if not select.select([], [device], [], _WRITE_TIMEOUT)[1]:
                raise OSError(errno.ETIMEDOUT, "the device accepts no bytes")
            count = os.write(device, left)
            self._clock.traffic.written += count
            left = left[count:]
        return len(packet)

    def discard_until_quiet(self, quiet: float, longest: float) -> tuple[bytes, float]:
        """Read until the line is quiet for a time (s), for at most ``longest`` s.

        Returns:
            The bytes, and the time at which the last of them were read, s.
        """
        arrival = self._clock()
        end, discarded = arrival + longest, b""
        while self._clock() < end and self._wait(quiet):
            arrival = self._clock()
            discarded += self._read(4096)
        return discarded, arrival

    def _read(self, length: int) -> bytes:
        data: bytes = self.ser.read(length)
        self._clock.traffic.read += len(data)
        return data

    def _wait(self, timeout: float) -> bool:
        """Return True if bytes are available within a timeout (s). A timeout of 0 returns immediately."""
        return self._clock.wait_readable(self.ser.fileno(), timeout)

    def setupPort(self, cflag_baud: int) -> bool:  # noqa: N802
        """Open the device for exclusive use by this process."""
        if self.is_open:
            self.closePort()
        self.ser = serial.Serial(self.port_name, cflag_baud, timeout=0, exclusive=True)
        self.is_open = True
        serial_port.open_exclusively(self.ser.fileno())
        with contextlib.suppress(
            OSError, ValueError, AttributeError
        ):  # Not every tty supports this ioctl.
            self.ser.set_low_latency_mode(True)
        self.ser.reset_input_buffer()
        self.tx_time_per_byte = 10 * 1000.0 / cflag_baud
        return True

    def closePort(self) -> None:  # noqa: N802
        """Close the device and permit other programs to open it."""
        if self.is_open:
            self.is_open = False
            serial_port.end_exclusive_use(self.ser.fileno())
            self.ser.close()


def stuff(body: bytes) -> bytes:
    """Insert FD after every FF FF FD. ``body`` runs from the instruction to the last parameter."""
    return body.replace(_HEADER, _HEADER + b"\xfd")


def unstuff(body: bytes) -> bytes:
    """Remove the FD that follows every FF FF FD. ``body`` runs from the instruction to the last parameter."""
    return body.replace(_HEADER + b"\xfd", _HEADER)


class _PacketHandler(Protocol2PacketHandler):
    """The SDK's packet handler with correct insertion and removal of byte stuffing."""

    def addStuffing(self, packet: list[int]) -> list[int]:  # noqa: N802
        """Stuff a packet in place. The SDK ignores the return value and sends the list that it passed as argument."""
        end = _INSTRUCTION + (packet[_LENGTH] | packet[_LENGTH + 1] << 8) - 2
        body = stuff(bytes(packet[_INSTRUCTION:end]))
        packet[_INSTRUCTION:] = [*body, 0, 0]
        packet[_LENGTH], packet[_LENGTH + 1] = (len(body) + 2) & 0xFF, (len(body) + 2) >> 8
        return packet

    def removeStuffing(self, packet: list[int]) -> list[int]:  # noqa: N802
        """Return the packet without its stuffing and without the bytes after its end."""
        end = _INSTRUCTION + (packet[_LENGTH] | packet[_LENGTH + 1] << 8) - 2
        body = unstuff(bytes(packet[_INSTRUCTION:end]))
        head = list(packet[:_INSTRUCTION])
        head[_LENGTH], head[_LENGTH + 1] = (len(body) + 2) & 0xFF, (len(body) + 2) >> 8
        return [*head, *body, *packet[end : end + 2]]


@dataclass
class ServoBus:
    """Exchanges with the servos on one port, with a limited number of retries. Values are raw.

    Every exchange raises PortError if the port is gone. Threads may share the object, because a lock separates their
    exchanges.

    Attributes:
        port: open port.
        retries: largest number of repetitions of a failed request to a single servo. Group requests are not repeated.
        counters: numbers of exchanges and failures.
    """

    port: BusPort
    retries: int = 1
    counters: BusCounters = field(default_factory=BusCounters)
    _handler: _PacketHandler = field(default_factory=_PacketHandler)
    _lock: threading.Lock = field(default_factory=threading.Lock)
    _garbled: bool = False
    _contradictory: set[int] = field(default_factory=set)
    _settled: bool = False
    _quiet: float = 0.0
    _unanswered: dict[int, float] = field(default_factory=dict)  # time of the oldest request, s
    _late: dict[int, tuple[float, float]] = field(default_factory=dict)  # arrival and delay, s

    @staticmethod
    def open(
        path: str, baud_rate: int, latency: float | None = None, retries: int = 1
    ) -> "ServoBus":
        """Open a serial port exclusively.

        Args:
            path: path of the port.
            baud_rate: bit/s.
            latency: longest time that the adapter delays an answer, s. None: the adapter's latency timer, or 1 ms
                without a timer. The timer is read after the port was opened, because opening it requests a low latency.
            retries: see `ServoBus`.

        Raises:
            PortError: The port is missing, forbidden or in use. The message contains the remedy.
            ConfigurationError: The SDK does not support the baud rate, or the path is not a serial device.
        """
        if reason := serial_port.why_no_port(path):
            raise ConfigurationError(reason)
        bus = ServoBus(BusPort(path, baud_rate), retries)
        bus.set_baud_rate(baud_rate)
        if latency is None:
            latency = (serial_port.latency_timer_ms(path) or 1) * 1e-3
        bus.port.latency = latency
        return bus

    def set_baud_rate(self, baud_rate: int) -> None:
        """Open the port, again if it is open, with a baud rate (bit/s). Raises as `open`."""
        path = self.port.port_name
        try:
            if not self.port.setBaudRate(baud_rate):
                raise ConfigurationError(
                    f"the SDK cannot set the baud rate {baud_rate}: use a rate of the register baud_rate (e-manual)"
                )
        # SerialException is an OSError, termios.error is not.
        except (OSError, termios.error) as error:
            raise PortError(serial_port.explain_open_failure(path, error)) from error
        self._settled = False

    def close(self) -> None:
        """Close the port. Has no effect if it is closed or gone."""
        with contextlib.suppress(OSError):
            self.port.closePort()

    @contextlib.contextmanager
    def retrying(self, retries: int = _SETUP_RETRIES) -> Iterator[None]:
        """Enter a context for setup, in which exchanges may take longer but fail less often.

        A failed request to a single servo is repeated at most ``retries`` times, or ``self.retries`` times if this is
        more. Before the first request, and before each request after a missing or unusable answer, the bus waits until
        no older answer can arrive. An answer with an error number is complete, so the bus does not wait after it.
        """
        before = self.retries, self._quiet
        self.retries, self._quiet = max(self.retries, retries), _LATEST
        self._settled = False
        try:
            yield
        finally:
            self.retries, self._quiet = before

    def ping(self, servo: int) -> Identity:
        """Return the model number and the firmware of a servo."""
        return Identity(*_IDENTITY.unpack(self._command(servo, _PING, b"", _IDENTITY.size)))

    def scan(self) -> dict[int, Identity]:
        """Ping all servos at once. Return the model number and the firmware of those that answer, by id.

        Raises:
            CorruptReplyError: Answers are garbled, or two have the same id. The message contains the ids.
        """
        answers: list[int] = []
        found = {}
        with self._question():
            self._begin(())
            self._send(BROADCAST, _PING)
            self.port.begin_wait(_PING_SLOT * BROADCAST + self.port.answer_time(14 * BROADCAST))
            while self.port.expects:
                answer = self._receive()
                if answer is not None and len(data := self._reply(answer).data) == _IDENTITY.size:
                    answers.append(answer[_ID])
                    found[answer[_ID]] = Identity(*_IDENTITY.unpack(data))
        if self._garbled or len(answers) > len(found):
            ids = ", ".join(map(str, sorted(answers))) or "none"
            raise CorruptReplyError(
                f"answers to a ping of all servos are garbled or doubled (ids {ids}): check the cable, and {_SHARED_ID}"
            )
        return found

    def read(self, servo: int, register: Register) -> int:
        """Return a register's raw value."""
        return register.unpack(self.read_block(servo, register.address, register.size))

    def read_block(self, servo: int, start: int, size: int) -> bytes:
        """Return a block of the control table."""
        return self._command(servo, _READ, _BLOCK.pack(start, size), size)

    def write(self, servo: int, register: Register, raw: int) -> None:
        """Write a register with acknowledgement by the servo."""
        data = register.address.to_bytes(2, "little") + register.pack(raw)
        self._command(servo, _WRITE, data, 0)

    def reboot(self, servo: int) -> None:
        """Restart a servo. The servo loses its torque and its turn count."""
        self._command(servo, _REBOOT, b"", 0)

    def sync_write(self, register: Register, values: Mapping[int, int]) -> None:
        """Write a register of several servos at once, without acknowledgement."""
        if not values:
            return
        goals = b"".join(bytes((servo, *register.pack(raw))) for servo, raw in values.items())
        with self._exchange():
            block = _BLOCK.pack(register.address, register.size)
            self._send(BROADCAST, _SYNC_WRITE, block + goals)

    def sync_read(
        self, start: int, size: int, servos: Sequence[int]
    ) -> tuple[float, dict[int, Reply]]:
        """Return a block of the control table of several servos. Servos without an intact answer are omitted.

        The method does not repeat the request; the caller decides on a repetition. A reply with an error number has no
        valid data. Servos answer in the order of the ids in the request, so an answer out of this order is not
        accepted.

        The method stops reading when every servo has answered. If two answers until then have the same id and different
        contents, neither is accepted. A later answer is not read. The next request discards it if it has arrived
        before. Otherwise it counts as an answer to the next request, and only ``tick_clock`` can detect it.

        Args:
            start: address of the block.
            size: size of the block, bytes.
            servos: ids.

        Returns:
            Time at which the request was sent (s, monotonic), and the replies by id.
        """
        replies: dict[int, Reply] = {}
        doubted: set[int] = set()
        if not servos:
            return self.now(), replies
        with self._question():
            requested_at = self._begin(servos)
            self._send(BROADCAST, _SYNC_READ, _BLOCK.pack(start, size) + bytes(servos))
            self.port.begin_wait(self.answer_time(size, len(servos)))
            while len(replies) < len(servos) and self.port.expects:
                packet = self._receive()
                if packet is None:
                    continue
                servo, reply = packet[_ID], self._reply(packet)
                if servo not in servos or not (len(reply.data) == size or reply.error):
                    self.count(corrupt=1)
                elif servo in replies:
                    if reply != replies[servo]:
                        doubted.add(servo)
                elif any(servos.index(servo) < servos.index(earlier) for earlier in replies):
                    doubted.add(servo)
                else:
                    replies[servo] = reply
        for servo in doubted:
            replies.pop(servo, None)
        self._contradictory = doubted
        self._note_answers(replies)
        self.count(corrupt=len(doubted), errors=sum(reply.error != 0 for reply in replies.values()))
        if len(replies) < len(servos):
            self.count(timeouts=1)
            self._settled = False
        return requested_at, replies

    def now(self) -> float:
        """Return the time (s, monotonic) of the port's clock."""
        return self.port.getCurrentTime() * 1e-3

    def answer_time(self, size: int, servos: int) -> float:
        """Return how long (s) a sync read of ``size`` bytes from each of ``servos`` servos waits for its answers."""
        return self.port.answer_time((11 + size) * servos)

    def torque_off_all(self) -> None:
        """Switch off the torque of all servos on the bus, by broadcast and without acknowledgement."""
        with self._exchange():
            address = COMMON["torque_enable"].address.to_bytes(2, "little")
            self._send(BROADCAST, _WRITE, address + b"\0")

    def count_stale(self, servo: int, delay: float) -> None:
        """Count an answer that is older than its request, by a delay (s). The next request waits for a quiet line."""
        self.count(stale=1)
        self._late[servo] = self.now(), delay
        self._settled = False

    def why_no_answer(self, servo: int, where: str = "") -> str:
        """Return what the bus received instead of an answer of a servo to the last request, and the remedy.

        ``where`` describes the bus, with a leading space.
        """
        arrival, delay = self._late.get(servo, (-math.inf, 0.0))
        if self.now() - arrival < _REMEMBERED:
            return f"answers late ({delay * 1e3:.0f} ms after a request): {_LATE_REMEDY}"
        if servo in self._contradictory:
            return f"sends contradictory answers, or answers out of turn: {_LATE_REMEDY}, and {_SHARED_ID}"
        if self._garbled:
            return f"does not answer, or its answers are garbled: check its power, its cable, and {_SHARED_ID}"
        waited = self.now() - self._unanswered.get(servo, self.now())
        return (
            f"does not answer{where} (nothing arrived for {waited * 1e3:.0f} ms): {_SILENCE_REMEDY}, and "
            "whether its answers are later than that"
        )

    def require_quiet_line(self) -> None:
        """Make the next request wait for a quiet line, on which no late answer can arrive."""
        self._settled = False

    def _command(self, servo: int, instruction: int, parameters: bytes, size: int) -> bytes:
        for attempt in range(self.retries + 1):
            if attempt:
                self.count(retries=1)
            try:
                return self._attempt(servo, instruction, parameters, size)
            except (NoReplyError, CorruptReplyError):
                self._settled = False
                if attempt == self.retries:
                    raise
            except StatusError as error:
                if attempt == self.retries or not error.is_noise:
                    raise
        raise AssertionError("unreachable")

    def _attempt(self, servo: int, instruction: int, parameters: bytes, size: int) -> bytes:
        with self._question():
            self._begin((servo,))
            self._send(servo, instruction, parameters)
            self.port.setPacketTimeout(11 + size)
            while self.port.expects:
                answer = self._receive()
                if answer is not None and answer[_ID] == servo:
                    self._note_answers((servo,))
                    return self._content(servo, self._reply(answer), size)
        where = f" on {self.port.port_name} at {self.port.baudrate} baud"
        reason = f"servo {servo} {self.why_no_answer(servo, where)}"
        if self._garbled:
            raise CorruptReplyError(reason)
        self.count(timeouts=1)
        raise NoReplyError(reason)

    def _begin(self, servos: Sequence[int]) -> float:
        """Record a request to servos, and return its time (s)."""
        now, self._garbled, self._contradictory = self.now(), False, set()
        for servo in servos:
            self._unanswered.setdefault(servo, now)
        return now

    def _note_answers(self, servos: Iterable[int]) -> None:
        """Record intact answers to the last request."""
        for servo in servos:
            self._unanswered.pop(servo, None)
            self._late.pop(servo, None)

    def _note_late(self, discarded: bytes, arrival: float) -> None:
        """Record the servos whose answers arrived too late (s), among the discarded bytes."""
        for head in _STATUS.finditer(discarded):
            servo = head[1][0]
            if servo in self._unanswered:
                # Only the first late answer certainly belongs to the oldest request.
                delay = self._late.get(servo, (0.0, arrival - self._unanswered[servo]))[1]
                self._late[servo] = arrival, delay

    def _content(self, servo: int, reply: Reply, size: int) -> bytes:
        if reply.error:
            self.count(errors=1)
            raise StatusError(f"servo {servo} {error_text(reply.error)}", reply.error)
        if len(reply.data) != size:
            self.count(corrupt=1)
            raise CorruptReplyError(
                f"servo {servo} answered {len(reply.data)} bytes instead of {size}"
            )
        return reply.data

    def _receive(self) -> list[int] | None:
        """Return the next status packet; None if it is garbled, or if none arrives before the timeout."""
        packet, result = self._handler.rxPacket(self.port, False)
        if result == COMM_SUCCESS and len(packet) >= _PARAMETERS + 2:
            return packet
        if packet:
            self._garbled = True
            self.count(corrupt=1)
        return None

    @contextlib.contextmanager
    def _exchange(self) -> Iterator[None]:
        with self._lock:
            self.count(exchanges=1)
            try:
                yield
            # termios.error is not an OSError. The SDK raises it when it clears the line before it sends.
            except (OSError, termios.error) as error:
                raise PortError(
                    f"servo bus {self.port.port_name} is gone ({error}). Connect the adapter again (or start the "
                    "virtual robot again). If the driver is active, deactivate it: the deactivation fails, because no "
                    "servo confirms that its torque is off, and the driver becomes unconfigured. If the driver is "
                    "inactive, call cleanup. Then configure and activate the driver"
                ) from error
            finally:
                self.port.is_using = False

    @contextlib.contextmanager
    def _question(self) -> Iterator[None]:
        """Enter an exchange that expects answers. If a late answer may still arrive, first wait for a quiet line."""
        with self._exchange():
            if not self._settled:
                quiet = max(self._quiet, self.port.quiet_time)
                self._note_late(*self.port.discard_until_quiet(quiet, longest=5 * quiet))
                self._settled = True
            yield

    def _reply(self, packet: Sequence[int]) -> Reply:
        error = packet[_ERROR]
        data = bytes(packet[_PARAMETERS:-2])
        return Reply(data, bool(error & _ALERT), error & ~_ALERT, self.now())

    def _send(self, servo: int, instruction: int, parameters: bytes = b"") -> None:
        """Send a packet. The SDK fills in header and checksum, and stuffs the packet."""
        length = (len(parameters) + 3).to_bytes(2, "little")
        packet = [0, 0, 0, 0, servo, *length, instruction, *parameters, 0, 0]
        result = self._handler.txPacket(self.port, packet)
        if result != COMM_SUCCESS:
            cause = "not all bytes were sent" if result == COMM_TX_FAIL else f"SDK result {result}"
            raise BusError(f"cannot send on {self.port.port_name}: {cause}")

    def count(self, **more: int) -> None:
        """Increase counters, by their names in `BusCounters`."""
        now = self.counters
        self.counters = replace(now, **{name: getattr(now, name) + n for name, n in more.items()})
