# SPDX-License-Identifier: Apache-2.0
"""Replacement for smbus2.SMBus that sends transactions through a socket, as to the process of a virtual robot.

The socket preserves packets (SOCK_SEQPACKET). A request is three bytes (operation, address, register), then the data to
write. An answer is the errno (two bytes) followed by the data read. As with the kernel, the first byte of a word is its
low byte, and a missing acknowledgement raises OSError(EREMOTEIO).
"""

import errno
import os
import socket
import struct
from dataclasses import dataclass

_REQUEST = struct.Struct("<BBB")
_ANSWER = struct.Struct("<H")

READ = 0  # the master writes the register number, then reads a word
WRITE = 1  # the master writes the register number and the data

_TIMEOUT = 60.0  # s; the robot itself simulates a hanging bus, so that this timeout only detects a hanging process
_LONGEST = 512  # more than the longest answer, bytes


@dataclass(frozen=True)
class Request:
    """SMBus transaction. operation: READ or WRITE; address: 7 bit; data: bytes to write."""

    operation: int
    address: int
    register: int = 0
    data: bytes = b""


@dataclass(frozen=True)
class Answer:
    """Result of a transaction. errno: 0 if successful; data: the bytes read; delay: duration of the transaction, s.

    The delay is not part of the packet: the server sends the packet after the delay.
    """

    errno: int
    data: bytes = b""
    delay: float = 0.0


def pack_request(request: Request) -> bytes:
    """Return the packet of a request."""
    return _REQUEST.pack(request.operation, request.address, request.register) + request.data


def unpack_request(packet: bytes) -> Request:
    """Return the request of a packet. Raises struct.error if it is too short."""
    operation, address, register = _REQUEST.unpack_from(packet)
    return Request(operation, address, register, packet[_REQUEST.size :])


def pack_answer(answer: Answer) -> bytes:
    """Return the packet of an answer."""
    return _ANSWER.pack(answer.errno) + answer.data


def unpack_answer(packet: bytes) -> Answer:
    """Return the answer of a packet, without its delay."""
    (number,) = _ANSWER.unpack_from(packet)
    return Answer(number, packet[_ANSWER.size :])


class SocketSMBus:
    """Methods of smbus2.SMBus that power/i2c.py uses, on the socket of a virtual robot. All raise OSError.

    ``i2c_addr`` is the 7-bit address, ``register`` a byte and ``value`` a word.
    """

    def __init__(self, bus: str) -> None:
        """Connect to a path. Raises FileNotFoundError or ConnectionRefusedError if no robot is running there."""
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._socket.settimeout(_TIMEOUT)
        try:
            self._socket.connect(bus)
        except OSError:
            self.close()
            raise

    def close(self) -> None:
        """Close the connection; repeated calls have no effect."""
        self._socket.close()

    def read_word_data(self, i2c_addr: int, register: int) -> int:
        """Read two bytes of a register, low byte first."""
        return int.from_bytes(self._transact(Request(READ, i2c_addr, register)), "little")

    def write_word_data(self, i2c_addr: int, register: int, value: int) -> None:
        """Write two bytes to a register, low byte first."""
        data = value.to_bytes(2, "little")
        self._transact(Request(WRITE, i2c_addr, register, data=data))

    def _transact(self, request: Request) -> bytes:
        try:
            self._socket.sendall(pack_request(request))
            packet = self._socket.recv(_LONGEST)
        except TimeoutError:
            self.close()  # a late answer must not be read as the answer to the next request
            raise OSError(errno.ETIMEDOUT, os.strerror(errno.ETIMEDOUT)) from None
        except ConnectionError:
            packet = b""
        # Without a packet, the robot's process has ended.
        answer = unpack_answer(packet) if packet else Answer(errno.EIO)
        if answer.errno:
            raise OSError(answer.errno, os.strerror(answer.errno))
        return answer.data
