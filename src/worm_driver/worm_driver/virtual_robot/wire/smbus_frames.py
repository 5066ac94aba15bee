# SPDX-License-Identifier: Apache-2.0
"""Packets that each contain one SMBus transaction, for a socket that preserves packets (SOCK_SEQPACKET).

A request is four bytes (operation, address, register, number of bytes to read) followed by the data to write. An answer
is the errno (two bytes) followed by the data read. Data bytes are in the order of the bus. As with a real adapter, the
client combines them into words.
"""

import struct
from dataclasses import dataclass

_REQUEST = struct.Struct("<BBBB")
_ANSWER = struct.Struct("<H")

READ = 0  # the master writes the register number, then reads `length` bytes
WRITE = 1  # the master writes the register number and the data


@dataclass(frozen=True)
class Request:
    """SMBus transaction. operation: READ or WRITE; address: 7 bit; length: number of bytes to read."""

    operation: int
    address: int
    register: int = 0
    length: int = 0
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
    head = _REQUEST.pack(request.operation, request.address, request.register, request.length)
    return head + request.data


def unpack_request(packet: bytes) -> Request:
    """Return the request of a packet. Raises struct.error if it is too short."""
    operation, address, register, length = _REQUEST.unpack_from(packet)
    return Request(operation, address, register, length, packet[_REQUEST.size :])


def pack_answer(answer: Answer) -> bytes:
    """Return the packet of an answer."""
    return _ANSWER.pack(answer.errno) + answer.data


def unpack_answer(packet: bytes) -> Answer:
    """Return the answer of a packet, without its delay."""
    (number,) = _ANSWER.unpack_from(packet)
    return Answer(number, packet[_ANSWER.size :])
