# SPDX-License-Identifier: Apache-2.0
"""Frames that carry single SMBus transactions over a stream socket.

A request is five bytes (operation, address, register, read length, number of data bytes) and the
data; an answer is three bytes (errno as two, number of data bytes) and the data. Data bytes are in
the order of the wire: what a word means is the client's business, as with a real adapter.
"""

import struct
from dataclasses import dataclass

_REQUEST = struct.Struct("<BBBBB")
_ANSWER = struct.Struct("<HB")

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

    The time is not part of the frame: it is how much later the frame is sent.
    """

    errno: int
    data: bytes = b""
    delay: float = 0.0


def pack_request(request: Request) -> bytes:
    """The frame of a request."""
    head = _REQUEST.pack(
        request.operation, request.address, request.register, request.length, len(request.data)
    )
    return head + request.data


def take_request(buffer: bytes) -> tuple[Request | None, bytes]:
    """The first request of a buffer, None while it is incomplete, and the rest of the buffer."""
    if len(buffer) < _REQUEST.size:
        return None, buffer
    operation, address, register, length, count = _REQUEST.unpack_from(buffer)
    end = _REQUEST.size + count
    if len(buffer) < end:
        return None, buffer
    data = buffer[_REQUEST.size : end]
    return Request(operation, address, register, length, data), buffer[end:]


def pack_answer(answer: Answer) -> bytes:
    """The frame of an answer."""
    return _ANSWER.pack(answer.errno, len(answer.data)) + answer.data


def take_answer(buffer: bytes) -> tuple[Answer | None, bytes]:
    """The first answer of a buffer, None while it is incomplete, and the rest of the buffer."""
    if len(buffer) < _ANSWER.size:
        return None, buffer
    errno, count = _ANSWER.unpack_from(buffer)
    end = _ANSWER.size + count
    if len(buffer) < end:
        return None, buffer
    return Answer(errno, buffer[_ANSWER.size : end]), buffer[end:]
