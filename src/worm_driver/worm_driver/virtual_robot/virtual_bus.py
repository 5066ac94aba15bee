# SPDX-License-Identifier: Apache-2.0
"""Servo bus: receives instruction packets and returns status packets, with faults of the serial line."""

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from random import Random

from worm_driver.servos.registers import COMMON
from worm_driver.virtual_robot.servo.control_table import BAUD_RATES, PROTOCOL_2
from worm_driver.virtual_robot.servo.register_memory import RegisterError
from worm_driver.virtual_robot.servo.virtual_servo import Servo
from worm_driver.virtual_robot.wire.faults import Fault, FaultBoard
from worm_driver.virtual_robot.wire.packet import (
    ALERT,
    BROADCAST_ID,
    Error,
    Instruction,
    InstructionReader,
    Packet,
    status_packet,
)

_POSITION = COMMON["present_position"]
#: s, longest gap between the bytes of a packet; 1.5 ms on a real line, but a pseudo-terminal is read when the scheduler
#: permits
_ALLOWED_GAP = 0.050


@dataclass(frozen=True)
class Transmission:
    """Bytes to send at a time (s)."""

    time: float
    data: bytes


@dataclass(frozen=True)
class _Answer:
    """Answer of a servo: its id when the request arrived, delay (s), complete error byte, data."""

    servo_id: int
    delay: float
    error: int
    data: bytes = b""


def _answer_of(servo: Servo, number: int = Error.NONE, data: bytes = b"") -> _Answer:
    return _Answer(servo.servo_id, servo.return_delay, number | servo.alert(), data)


class ServoBus:
    """Servos on one serial line. Without injected faults, they send packets in the format of real servos.

    Args:
        servos: the servos.
        board: injected faults.
        random: source of fuzzed bytes.
    """

    def __init__(self, servos: Sequence[Servo], board: FaultBoard, random: Random) -> None:
        self._servos = servos
        self._board = board
        self._random = random
        self._reader = InstructionReader(_ALLOWED_GAP)
        self._last_sent = 0.0

    def feed(self, data: bytes, time: float, baud_rate: int | None = None) -> list[Transmission]:
        """Return the answers to bytes received at a time (s) with a baud rate (bit/s; None: the correct one)."""
        answers: list[Transmission] = []
        for packet in self._reader.feed(data, time):
            for answer in self._answer(packet, time, baud_rate):
                # Bytes cannot overtake each other, so packets after a late one are late, too.
                self._last_sent = max(answer.time, self._last_sent)
                answers.append(Transmission(self._last_sent, answer.data))
        return answers

    def _answer(self, packet: Packet, time: float, baud_rate: int | None) -> list[Transmission]:
        listening = [
            servo
            for servo in self._servos
            if servo.answers(time)
            and servo.memory["protocol_type"] == PROTOCOL_2
            and not self._board.active("vanished", time, servo.servo_id)
            and baud_rate in (None, BAUD_RATES[servo.memory["baud_rate"]])
        ]
        match packet.instruction:
            case _ if not packet.intact:
                meant = (servo for servo in listening if servo.servo_id == packet.servo_id)
                answers = [_answer_of(servo, Error.CRC) for servo in meant]
            case Instruction.SYNC_READ:
                answers = _group_read(packet, listening, time)
            case Instruction.SYNC_WRITE:
                _group_write(packet, listening, time)
                answers = []
            case _:
                answers = _obey(packet, listening, time)
        sent: list[Transmission] = []
        due = time
        for answer in self._misread(packet, answers, time):
            due += answer.delay
            sent += self._spoil(answer, due)
        return sent

    def _misread(
        self, packet: Packet, answers: Sequence[_Answer], time: float
    ) -> Sequence[_Answer]:
        """Return the answers. While WRONG_POSITION is active, positions in answers to Read and Sync Read are wrong."""
        is_read = packet.instruction in (Instruction.READ, Instruction.SYNC_READ)
        if not is_read or len(packet.parameters) < 4:
            return answers
        address, length = _range(packet.parameters)
        begin = _POSITION.address - address
        end = begin + _POSITION.size
        if begin < 0 or end > length:
            return answers
        return [
            replace(answer, data=_offset(answer.data, begin, end, int(fault.value)))
            if answer.data
            and (fault := self._board.consume("wrong_position", time, answer.servo_id))
            else answer
            for answer in answers
        ]

    def _spoil(self, answer: _Answer, due: float) -> list[Transmission]:
        """Return the status packet of an answer, changed by the active faults of the serial line."""

        def take(name: str) -> Fault | None:
            return self._board.consume(name, due, answer.servo_id)

        if take("no_answer"):
            return []
        if fault := take("error"):
            answer = replace(answer, error=int(fault.value) | answer.error & ALERT, data=b"")
        sender = take("wrong_id")
        servo_id = answer.servo_id if sender is None else int(sender.value)
        data = status_packet(servo_id, answer.error, answer.data)
        if take("corrupted_crc"):
            data = data[:-1] + bytes([data[-1] ^ 0x5A])
        if take("truncated"):
            data = data[: len(data) // 2]
        if take("duplicated"):
            data += data
        if take("fuzzed"):
            data = _fuzz(data, self._random)
        if fault := take("late"):
            due += fault.value
        return [Transmission(due, data)]


def _offset(data: bytes, begin: int, end: int, ticks: int) -> bytes:
    """Return data with a number of ticks added to the position in it."""
    wrong = int.from_bytes(data[begin:end], "little", signed=True) + ticks
    return data[:begin] + wrong.to_bytes(end - begin, "little", signed=True) + data[end:]


def _fuzz(data: bytes, random: Random) -> bytes:
    """Return data with at most three bytes changed, and possibly some lost and some added."""
    fuzzed = bytearray(data)
    for _ in range(random.randint(0, 3)):
        fuzzed[random.randrange(len(fuzzed))] = random.randrange(256)
    start = random.randrange(len(fuzzed))
    if random.random() < 0.5:
        del fuzzed[start : start + random.randint(1, 4)]
    if random.random() < 0.5:
        fuzzed[start:start] = random.randbytes(random.randint(1, 12))
    return bytes(fuzzed)


def _obey(packet: Packet, listening: Sequence[Servo], time: float) -> list[_Answer]:
    """Execute an instruction for one servo or for all. Return the answers in the order of ids."""
    broadcast = packet.servo_id == BROADCAST_ID
    is_ping, is_read = (packet.instruction == i for i in (Instruction.PING, Instruction.READ))
    meant = [servo for servo in listening if broadcast or servo.servo_id == packet.servo_id]
    answers = []
    for servo in sorted(meant, key=lambda servo: servo.servo_id):
        level = servo.memory["status_return_level"]
        servo.feed_watchdog(time)
        answer = _answer_of(
            servo
        )  # A write may change id and delay. The answer has the old values.
        try:
            data = _execute(servo, packet, time)
        except RegisterError as error:
            answer = replace(answer, error=error.number | servo.alert())
        else:
            if packet.instruction != Instruction.REBOOT:
                answer = replace(answer, error=servo.alert(), data=data)
        if is_ping or (not broadcast and (level == 2 or (level == 1 and is_read))):
            answers.append(answer)
    return answers


def _execute(servo: Servo, packet: Packet, time: float) -> bytes:
    parameters = packet.parameters
    match packet.instruction:
        case Instruction.PING:
            return servo.read(0, 2) + servo.read(6, 1)
        case Instruction.READ:
            if len(parameters) != 4:
                raise RegisterError(Error.DATA_LENGTH)
            return servo.read(*_range(parameters))
        case Instruction.WRITE:
            if len(parameters) < 3:
                raise RegisterError(Error.DATA_LENGTH)
            servo.write(int.from_bytes(parameters[:2], "little"), parameters[2:])
        case Instruction.REBOOT:
            servo.reboot(time)
        case _:
            raise RegisterError(Error.INSTRUCTION)
    return b""


def _range(parameters: bytes) -> tuple[int, int]:
    """Return address and length from the first four parameter bytes."""
    return int.from_bytes(parameters[:2], "little"), int.from_bytes(parameters[2:4], "little")


def _group_read(packet: Packet, listening: Sequence[Servo], time: float) -> list[_Answer]:
    """Return the answers to a Sync Read in the order of its ids; an empty list if it is malformed.

    The request resets the watchdog of each servo in it, also of a servo whose status return level forbids an answer.
    """
    if len(packet.parameters) < 5:
        return []
    address, length = _range(packet.parameters)
    by_id = {servo.servo_id: servo for servo in listening}
    answers = []
    for servo in filter(None, map(by_id.get, packet.parameters[4:])):
        servo.feed_watchdog(time)
        if servo.memory["status_return_level"] == 0:
            continue
        try:
            answers.append(_answer_of(servo, data=servo.read(address, length)))
        except RegisterError as error:
            answers.append(_answer_of(servo, error.number))
    return answers


def _group_write(packet: Packet, listening: Sequence[Servo], time: float) -> None:
    """Execute a Sync Write, unless it is malformed. There is no answer, so a rejected write is not reported."""
    parameters = packet.parameters
    if len(parameters) < 4:
        return
    address, length = _range(parameters)
    items = [parameters[i : i + length + 1] for i in range(4, len(parameters), length + 1)]
    if any(len(item) != length + 1 for item in items):
        return
    by_id = {servo.servo_id: servo for servo in listening}
    for item in items:
        servo = by_id.get(item[0])
        if servo is not None:
            servo.feed_watchdog(time)
            with contextlib.suppress(RegisterError):
                servo.write(address, item[1:])
