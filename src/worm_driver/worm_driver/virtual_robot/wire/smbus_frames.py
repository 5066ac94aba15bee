# SPDX-License-Identifier: Apache-2.0
"""Packets that carry single SMBus transactions over a socket that keeps them apart (SOCK_SEQPACKET).

A request is four bytes (operation, address, register, read length) and the data to write; an answer is errno as two
bytes and the data read. Data bytes are in the order of the wire: what a word means is the client's business, as with
a real adapter.
"""

import struct
from dataclasses import dataclass

_REQUEST = struct.Struct("<BBBB")
_ANSWER = struct.Struct("<H")

READ = 0  # write the register pointer, then read `length` bytes
WRITE = 1  # write the register pointer and the data


@dataclass(frozen=True)
class Request:
    """One transaction. address: 7 bit; length: bytes to read."""

    operation: int
    address: int
    register: int = 0
    length: int = 0
    data: bytes = b""


@dataclass(frozen=True)
class Answer:
    """errno of the failed transaction, 0 for none, the bytes read, and how long (s) it all took.

    The time is not part of the packet: it is how much later the packet is sent.
    """

    errno: int
    data: bytes = b""
    delay: float = 0.0


def pack_request(request: Request) -> bytes:
    """The packet of a request."""
    head = _REQUEST.pack(request.operation, request.address, request.register, request.length)
    return head + request.data


def unpack_request(packet: bytes) -> Request:
    """The request of a packet. Raises struct.error where it is too short."""
    operation, address, register, length = _REQUEST.unpack_from(packet)
    return Request(operation, address, register, length, packet[_REQUEST.size :])


def pack_answer(answer: Answer) -> bytes:
    """The packet of an answer."""
    return _ANSWER.pack(answer.errno) + answer.data


def unpack_answer(packet: bytes) -> Answer:
    """The answer of a packet; the time that it took is not in it."""
    (number,) = _ANSWER.unpack_from(packet)
    return Answer(number, packet[_ANSWER.size :])
