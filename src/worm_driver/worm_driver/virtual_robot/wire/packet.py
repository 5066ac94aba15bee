# SPDX-License-Identifier: Apache-2.0
"""Dynamixel Protocol 2.0 packets on the servo's side: checksum, byte stuffing, framing.

Except for the checksum, the module is written from the ROBOTIS e-manual, independently of the SDK, whose byte stuffing
has faults. If the driver understands packets of this module, this is therefore evidence that both are correct.
"""

import re
from dataclasses import dataclass
from enum import IntEnum

from dynamixel_sdk import Protocol2PacketHandler

HEADER = b"\xff\xff\xfd"
BROADCAST_ID = 0xFE
HIGHEST_ID = 0xFC
STATUS = 0x55
ALERT = 0x80  # bit 7 of the error byte: look at Hardware Error Status

_PREFIX = HEADER + b"\x00"
_OVERHEAD = 7  # header, reserved byte, id, length
_LONGEST = 1024  # largest accepted number of bytes after the length field; instructions of the driver need fewer
_BARE_HEADER = re.compile(rb"\xff\xff\xfd(?!\xfd)")


class Instruction(IntEnum):
    """Instructions that the virtual servos obey. They reject the others of the X series with an error number."""

    PING = 0x01
    READ = 0x02
    WRITE = 0x03
    REBOOT = 0x08
    SYNC_READ = 0x82
    SYNC_WRITE = 0x83


class Error(IntEnum):
    """Error numbers of a status packet, bits 6 to 0 of its error byte (numbers, not flags)."""

    NONE = 0
    RESULT_FAIL = 1
    INSTRUCTION = 2
    CRC = 3
    DATA_RANGE = 4
    DATA_LENGTH = 5
    DATA_LIMIT = 6
    ACCESS = 7


@dataclass(frozen=True)
class Packet:
    """Instruction packet without byte stuffing.

    ``instruction`` is the received byte, which need not be a valid Instruction. ``intact`` is True if the checksum is
    correct.
    """

    servo_id: int
    instruction: int
    parameters: bytes
    intact: bool = True


_update_crc = Protocol2PacketHandler().updateCRC


def crc16(data: bytes) -> int:
    """Return the protocol's CRC-16: polynomial 0x8005, most significant bit first, no final xor."""
    crc: int = _update_crc(0, data, len(data))
    return crc


def stuff(body: bytes) -> bytes:
    """Return the body (instruction to last parameter) with 0xFD inserted after each FF FF FD."""
    return body.replace(HEADER, HEADER + b"\xfd")


def unstuff(body: bytes) -> bytes:
    """Return the body without byte stuffing, the inverse of stuff()."""
    return body.replace(HEADER + b"\xfd", HEADER)


def frame(servo_id: int, body: bytes) -> bytes:
    """Return the packet of a body that is already stuffed."""
    packet = _PREFIX + bytes([servo_id]) + (len(body) + 2).to_bytes(2, "little") + body
    return packet + crc16(packet).to_bytes(2, "little")


def status_packet(servo_id: int, error: int, parameters: bytes = b"") -> bytes:
    """Return the bytes of a status packet. ``error`` is the complete error byte, with the alert bit."""
    return frame(servo_id, stuff(bytes([STATUS, error]) + parameters))


class InstructionReader:
    """Parser of instruction packets in a byte stream.

    A real servo drops a packet with a gap of more than 1.5 ms between bytes. A pseudo-terminal delivers bytes when the
    reader is scheduled. Therefore the allowed gap (s) is an argument.
    """

    def __init__(self, allowed_gap: float) -> None:
        self._allowed_gap = allowed_gap
        self._pending = b""
        self._last_time = 0.0

    def feed(self, data: bytes, time: float) -> list[Packet]:
        """Return the packets that are complete after these bytes, received at a time (s)."""
        if self._pending and time - self._last_time > self._allowed_gap:
            self._pending = b""
        self._pending += data
        self._last_time = time
        packets = []
        while (packet := self._next()) is not None:
            packets.append(packet)
        return packets

    def _next(self) -> Packet | None:
        while True:
            start = self._pending.find(HEADER)
            if start < 0:
                self._pending = self._pending[-2:]  # may be the start of a header
                return None
            self._pending = self._pending[start:]
            if len(self._pending) < _OVERHEAD:
                return None
            length = int.from_bytes(self._pending[5:7], "little")
            if self._pending[3] != 0 or not 3 <= length <= _LONGEST:
                self._pending = self._pending[1:]
                continue
            end = _OVERHEAD + length
            if len(self._pending) < end:
                return None
            body = self._pending[_OVERHEAD : end - 2]
            bare = _BARE_HEADER.search(body)
            if bare is not None:
                # An unstuffed header inside the body starts the next packet.
                self._pending = self._pending[_OVERHEAD + bare.start() :]
                continue
            return self._take(end, body)

    def _take(self, end: int, body: bytes) -> Packet:
        raw, self._pending = self._pending[:end], self._pending[end:]
        intact = crc16(raw[:-2]) == int.from_bytes(raw[-2:], "little")
        plain = unstuff(body)
        return Packet(raw[4], plain[0], plain[1:], intact)
