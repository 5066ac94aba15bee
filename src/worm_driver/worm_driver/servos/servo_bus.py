# SPDX-License-Identifier: Apache-2.0
"""The servo bus: Dynamixel Protocol 2.0 through dynamixel_sdk. The only module that imports it.

What version 4.1.0 of the SDK does behind its caller's back is put right here:

- it sends packets unstuffed, and takes stuffing out wrongly: ``_PacketHandler``;
- it measures timeouts by the wall clock, spins while it waits, and reads on for ever while bytes keep coming:
  ``BusPort``;
- it takes a late answer for the answer to the next question: after a failed exchange the next question waits for a
  quiet line, an answer must have the length asked for, and ``tick_clock`` checks the servo's own time in a block;
- it gives up by the clock without a look at what has come: a process that was held up reads that first;
- its GroupSyncRead forgets error and alert bytes, and loses good answers with a missing one: ``sync_read``;
- its busy flag sticks after an exception, and is no lock: ``_exchange``;
- it opens a port that another program uses: ``BusPort.setupPort``.
"""

import contextlib
import errno
import os
import select
import termios
import threading
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import serial
from dynamixel_sdk import COMM_SUCCESS, COMM_TX_FAIL, PortHandler, Protocol2PacketHandler

from worm_driver.clock import Clock, MachineClock
from worm_driver.errors import (
    BusError,
    ConfigurationError,
    CorruptReplyError,
    NoReplyError,
    PortError,
    StatusError,
)
from worm_driver.servos import serial_port
from worm_driver.servos.bus_types import BusCounters, Identity, Reply, error_text
from worm_driver.servos.encoding import pack, unpack
from worm_driver.servos.registers import COMMON, Register
from worm_driver.servos.stuffing import stuff, unstuff

BROADCAST = 254

#: what to look at when a servo is silent: all that explains it, as silence does not say which
SILENCE_REMEDY = (
    "check its power, its cable, its id and the baud rate (of a virtual robot: that it runs, and that no fault was "
    "injected)"
)

#: s, after which a write is given up: pyserial would wait for ever for an adapter that takes no bytes
_WRITE_TIMEOUT = 0.05
#: repetitions of an exchange while setting up
_PATIENT_RETRIES = 8
#: s, after which no answer is taken to be on its way any more, while setting up; shorter than the servos' bus watchdog
_LATEST = 0.06
#: bytes that may be read of a question whose time is over: more than have come while the process was held up is babble
_LEFT_OVER = 4096
# Where things stand in a packet; stuffing covers all from the instruction on.
_ID, _LENGTH, _INSTRUCTION, _ERROR, _PARAMETERS = 4, 5, 7, 8, 9
_ALERT = 0x80


class BusPort(PortHandler):
    """The SDK's port: monotonic time, waiting without spinning, exclusive.

    Attributes:
        latency: s, how long the adapter may hold an answer back.
    """

    def __init__(self, path: str, baud_rate: int):
        super().__init__(path)
        self.is_open = False
        self.baudrate = baud_rate
        self.latency = 0.001
        self._clock: Clock = MachineClock()
        self._left_over = 0

    def go_by(self, clock: Clock) -> None:
        """Has the thread that uses the port go by another clock, before the first exchange."""
        self._clock = clock

    def getCurrentTime(self) -> float:  # noqa: N802 (the SDK's name)
        """Now, ms: immune to a step of the wall clock."""
        return self._clock() * 1e3

    def setPacketTimeout(self, packet_length: int) -> None:  # noqa: N802
        """Starts the wait for an answer of a length."""
        self.begin_wait(self.answer_time(packet_length))

    def begin_wait(self, duration: float) -> None:
        """Starts a wait of a duration (s)."""
        self._left_over = _LEFT_OVER
        self.setPacketTimeoutMillis(duration * 1e3)

    def answer_time(self, packet_length: int) -> float:
        """How long (s) an answer may take: its time on the wire, twice the latency, and 2 ms."""
        return self.tx_time_per_byte * packet_length * 1e-3 + self.quiet_time

    @property
    def remaining(self) -> float:
        """What is left of the wait, s; 0 when it is over."""
        return max(0.0, self.packet_timeout - self.getTimeSinceStart()) * 1e-3

    @property
    def expects(self) -> bool:
        """Whether an answer may still come, or has come unread while the process was held up."""
        return self.remaining > 0.0 or (self._left_over > 0 and self._wait(0.0))

    def isPacketTimeout(self) -> bool:  # noqa: N802
        """Whether the wait is over."""
        return self.remaining <= 0.0

    @property
    def quiet_time(self) -> float:
        """How long the line must be silent before nothing late can be on its way, s."""
        return 2 * self.latency + 2e-3

    def readPort(self, length: int) -> bytes:  # noqa: N802
        """Up to ``length`` bytes; sleeps until some are there or the wait is over."""
        remaining = self.remaining
        if length <= 0 or self._left_over <= 0 or not self._wait(remaining):
            return b""
        data = self._read(length)
        if remaining <= 0.0:
            self._left_over -= len(data)
        return data

    def writePort(self, packet: Sequence[int]) -> int:  # noqa: N802
        """Sends all bytes. Raises OSError when the device takes none for too long."""
        left = memoryview(bytes(packet))
        device = self.ser.fileno()
        while left:
            if not select.select([], [device], [], _WRITE_TIMEOUT)[1]:
                raise OSError(errno.ETIMEDOUT, "it takes no bytes")
            count = os.write(device, left)
            self._clock.traffic.written += count
            left = left[count:]
        return len(packet)

    def discard_until_quiet(self, quiet: float, longest: float) -> None:
        """Throws bytes away until none came for a time (s), for at most ``longest`` s."""
        end = self._clock() + longest
        while self._clock() < end and self._wait(quiet):
            self._read(4096)

    def _read(self, length: int) -> bytes:
        data: bytes = self.ser.read(length)
        self._clock.traffic.read += len(data)
        return data

    def _wait(self, timeout: float) -> bool:
        """Whether bytes are there within a time (s), at once for 0."""
        return self._clock.wait_readable(self.ser.fileno(), timeout)

    def setupPort(self, cflag_baud: int) -> bool:  # noqa: N802
        """Opens the device for this process alone."""
        if self.is_open:
            self.closePort()
        self.ser = serial.Serial(self.port_name, cflag_baud, timeout=0, exclusive=True)
        self.is_open = True
        serial_port.refuse_other_openers(self.ser.fileno())
        with contextlib.suppress(
            OSError, ValueError, AttributeError
        ):  # not every tty has the ioctl
            self.ser.set_low_latency_mode(True)
        self.ser.reset_input_buffer()
        self.tx_time_per_byte = 10 * 1000.0 / cflag_baud
        return True

    def closePort(self) -> None:  # noqa: N802
        """Closes the device, and lets others open it."""
        if self.is_open:
            self.is_open = False
            serial_port.admit_other_openers(self.ser.fileno())
            self.ser.close()


class _PacketHandler(Protocol2PacketHandler):
    """The SDK's packet handler with byte stuffing that reaches the wire."""

    def addStuffing(self, packet: list[int]) -> list[int]:  # noqa: N802
        """Stuffs in place: the SDK drops what this returns, and sends the list that it passed."""
        end = _INSTRUCTION + (packet[_LENGTH] | packet[_LENGTH + 1] << 8) - 2
        body = stuff(bytes(packet[_INSTRUCTION:end]))
        packet[_INSTRUCTION:] = [*body, 0, 0]
        packet[_LENGTH], packet[_LENGTH + 1] = (len(body) + 2) & 0xFF, (len(body) + 2) >> 8
        return packet

    def removeStuffing(self, packet: list[int]) -> list[int]:  # noqa: N802
        """The packet without its stuffing, and without bytes that followed it."""
        end = _INSTRUCTION + (packet[_LENGTH] | packet[_LENGTH + 1] << 8) - 2
        body = unstuff(bytes(packet[_INSTRUCTION:end]))
        head = list(packet[:_INSTRUCTION])
        head[_LENGTH], head[_LENGTH + 1] = (len(body) + 2) & 0xFF, (len(body) + 2) >> 8
        return [*head, *body, *packet[end : end + 2]]


@dataclass
class ServoBus:
    """Exchanges with the servos on one port, with a retry budget. Values are raw.

    Every method raises PortError when the port is gone. The object may be handed from thread to thread; two threads
    at once are kept apart by a lock.

    Attributes:
        port: an open port.
        retries: how often a failed exchange is repeated.
    """

    port: BusPort
    retries: int = 1
    counters: BusCounters = field(default_factory=BusCounters)
    _handler: _PacketHandler = field(default_factory=_PacketHandler)
    _lock: threading.Lock = field(default_factory=threading.Lock)
    _garbled: bool = False
    _settled: bool = False
    _quiet: float = 0.0

    @staticmethod
    def open(
        path: str, baud_rate: int, latency: float | None = None, retries: int = 1
    ) -> "ServoBus":
        """Opens a serial port exclusively.

        Args:
            baud_rate: bit/s.
            latency: s, how long the adapter may hold an answer back; None: as long as its latency timer says
                once the port is open, for opening asks the adapter to be quick.

        Raises:
            PortError: it is missing, forbidden or in use; the message says what to do.
            ConfigurationError: the SDK does not know the baud rate, or the path is no serial device.
        """
        if reason := serial_port.why_no_port(path):
            raise ConfigurationError(reason)
        port = BusPort(path, baud_rate)
        try:
            if not port.openPort():
                raise ConfigurationError(
                    f"baud rate {baud_rate} is not one that the SDK can set: see addr 8 (baud_rate)"
                )
        # SerialException is an OSError; termios.error is none
        except (OSError, termios.error) as error:
            raise PortError(serial_port.explain_open_failure(path, error)) from error
        if latency is None:
            latency = (serial_port.latency_timer_ms(path) or 1) * 1e-3
        port.latency = latency
        return ServoBus(port, retries)

    def close(self) -> None:
        """Closes the port; harmless when it is closed or gone."""
        with contextlib.suppress(OSError):
            self.port.closePort()

    @contextlib.contextmanager
    def patient(self, retries: int = _PATIENT_RETRIES) -> Iterator[None]:
        """For set-up, where an answer counts more than its time.

        Failed exchanges are repeated more often; and the first question, like each one after a failure, waits until no
        older answer can be on its way.
        """
        before = self.retries, self._quiet
        self.retries, self._quiet = max(self.retries, retries), _LATEST
        self._settled = False
        try:
            yield
        finally:
            self.retries, self._quiet = before

    def ping(self, servo: int) -> Identity:
        """Model number and firmware of a servo. Raises BusError."""
        packet = [0] * 10
        packet[_ID], packet[_LENGTH], packet[_INSTRUCTION] = servo, 3, 1
        data = self._command(servo, packet, 3)
        return Identity(data[0] | data[1] << 8, data[2])

    def read(self, servo: int, register: Register) -> int:
        """A register's raw value. Raises BusError."""
        return unpack(register, self.read_block(servo, register.address, register.size))

    def read_block(self, servo: int, start: int, size: int) -> bytes:
        """A block of the control table. Raises BusError."""
        packet = [0] * 14
        packet[_ID], packet[_LENGTH], packet[_INSTRUCTION] = servo, 7, 2
        packet[8:12] = [*start.to_bytes(2, "little"), *size.to_bytes(2, "little")]
        return self._command(servo, packet, size)

    def write(self, servo: int, register: Register, raw: int) -> None:
        """Sets a register, acknowledged by the servo. Raises BusError."""
        packet = [0] * (12 + register.size)
        packet[_ID], packet[_LENGTH], packet[_INSTRUCTION] = servo, 5 + register.size, 3
        packet[8:-2] = [*register.address.to_bytes(2, "little"), *pack(register, raw)]
        self._command(servo, packet, 0)

    def reboot(self, servo: int) -> None:
        """Restarts a servo: torque and turn count are gone afterwards. Raises BusError."""
        packet = [0] * 10
        packet[_ID], packet[_LENGTH], packet[_INSTRUCTION] = servo, 3, 8
        self._command(servo, packet, 0)

    def sync_write(self, register: Register, values: Mapping[int, int]) -> None:
        """Sets a register of several servos at once; no servo acknowledges. Raises PortError."""
        if not values:
            return
        parameters = [
            byte for servo, raw in values.items() for byte in (servo, *pack(register, raw))
        ]
        with self._exchange() as handler:
            result = handler.syncWriteTxOnly(
                self.port, register.address, register.size, parameters, len(parameters)
            )
        self._check_sent(result)

    def sync_read(
        self, start: int, size: int, servos: Sequence[int]
    ) -> tuple[float, dict[int, Reply]]:
        """A block of the control table of several servos; one without an intact answer is left out.

        Returns when the question was sent (s, monotonic), and the replies by id. One attempt and no retry:
        the caller knows what a repetition is worth. A reply with an error has no data. Raises PortError.
        """
        replies: dict[int, Reply] = {}
        with self._question() as handler:
            asked = self.port.getCurrentTime() * 1e-3
            self._check_sent(
                handler.syncReadTx(self.port, start, size, list(servos), len(servos), False)
            )
            self.port.begin_wait(self.answer_time(size, len(servos)))
            while len(replies) < len(servos) and self.port.expects:
                packet = self._receive(handler)
                if packet is None:
                    continue
                servo, reply = packet[_ID], self._reply(packet)
                if servo in servos and (len(reply.data) == size or reply.error):
                    replies.setdefault(servo, reply)
                else:
                    self._count(corrupt=1)
        self._count(errors=sum(reply.error != 0 for reply in replies.values()))
        if len(replies) < len(servos):
            self._count(timeouts=1)
            self._settled = False
        return asked, replies

    def answer_time(self, size: int, servos: int) -> float:
        """How long (s) a sync read waits for its answers."""
        return self.port.answer_time((11 + size) * servos)

    def torque_off_all(self) -> None:
        """Takes the torque off every servo on the bus, by broadcast and without an answer. Raises PortError."""
        with self._exchange() as handler:
            torque = COMMON["torque_enable"]
            self._check_sent(handler.writeTxOnly(self.port, BROADCAST, torque.address, 1, [0]))

    def note_stale(self) -> None:
        """Notes an answer that was older than its question: the next question waits for a quiet line."""
        self._count(stale=1)
        self._settled = False

    def unsettle(self) -> None:
        """Has the next question begin on a quiet line, where nothing late can arrive any more."""
        self._settled = False

    def _command(self, servo: int, packet: list[int], size: int) -> bytes:
        for attempt in range(self.retries + 1):
            if attempt:
                self._count(retries=1)
            try:
                return self._attempt(servo, list(packet), size)
            except (NoReplyError, CorruptReplyError):
                self._settled = False
                if attempt == self.retries:
                    raise
            except StatusError as error:
                if attempt == self.retries or not error.is_noise:
                    raise
        raise AssertionError("unreachable")

    def _attempt(self, servo: int, packet: list[int], size: int) -> bytes:
        with self._question() as handler:
            self._check_sent(handler.txPacket(self.port, packet))
            self.port.setPacketTimeout(11 + size)
            self._garbled = False
            while self.port.expects:
                answer = self._receive(handler)
                if answer is not None and answer[_ID] == servo:
                    return self._content(servo, self._reply(answer), size)
        if self._garbled:
            raise CorruptReplyError(f"servo {servo} answers garbled on {self.port.port_name}")
        self._count(timeouts=1)
        raise NoReplyError(
            f"servo {servo} does not answer on {self.port.port_name} at {self.port.baudrate} baud: {SILENCE_REMEDY}"
        )

    def _content(self, servo: int, reply: Reply, size: int) -> bytes:
        if reply.error:
            self._count(errors=1)
            raise StatusError(f"servo {servo} {error_text(reply.error)}", reply.error)
        if len(reply.data) != size:
            self._count(corrupt=1)
            raise CorruptReplyError(
                f"servo {servo} answered {len(reply.data)} bytes where {size} were asked for"
            )
        return reply.data

    def _receive(self, handler: _PacketHandler) -> list[int] | None:
        """The next intact status packet within the wait, or None."""
        packet, result = handler.rxPacket(self.port, False)
        if result == COMM_SUCCESS and len(packet) >= _PARAMETERS + 2:
            return packet
        if packet:
            self._garbled = True
            self._count(corrupt=1)
        return None

    @contextlib.contextmanager
    def _exchange(self) -> Iterator[_PacketHandler]:
        with self._lock:
            self._count(exchanges=1)
            try:
                yield self._handler
            # termios.error, which is no OSError: the SDK clears the line before it sends
            except (OSError, termios.error) as error:
                raise PortError(
                    f"servo bus {self.port.port_name} is gone ({error}): plug it in again "
                    "(or start the virtual robot again), then deactivate the driver, or clean it up if it is "
                    "inactive, and configure it"
                ) from error
            finally:
                self.port.is_using = False

    @contextlib.contextmanager
    def _question(self) -> Iterator[_PacketHandler]:
        """An exchange with answers: begins on a quiet line."""
        with self._exchange() as handler:
            if not self._settled:
                quiet = max(self._quiet, self.port.quiet_time)
                self.port.discard_until_quiet(quiet, longest=5 * quiet)
                self._settled = True
            yield handler

    def _reply(self, packet: Sequence[int]) -> Reply:
        error, now = packet[_ERROR], self.port.getCurrentTime() * 1e-3
        return Reply(bytes(packet[_PARAMETERS:-2]), bool(error & _ALERT), error & ~_ALERT, now)

    def _check_sent(self, result: int) -> None:
        if result != COMM_SUCCESS:
            cause = "bytes were left over" if result == COMM_TX_FAIL else f"SDK result {result}"
            raise BusError(f"cannot send on {self.port.port_name}: {cause}")

    def _count(self, **more: int) -> None:
        now = self.counters
        self.counters = replace(now, **{name: getattr(now, name) + n for name, n in more.items()})
