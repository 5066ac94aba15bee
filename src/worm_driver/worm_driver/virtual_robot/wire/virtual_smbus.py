# SPDX-License-Identifier: Apache-2.0
"""Replacement for smbus2.SMBus that sends transactions to the virtual robot's process.

As with the kernel, the first byte of a word on the bus is its low byte, and a missing acknowledgement raises
OSError(EREMOTEIO).
"""

import errno
import os
import socket

from worm_driver.virtual_robot.wire import smbus_frames as frames
from worm_driver.virtual_robot.wire.smbus_frames import Request

_TIMEOUT = 60.0  # s; the robot itself simulates a hanging bus, so that this timeout only detects a hanging process
_LONGEST = 512  # longest answer, bytes; at most 255 of them are data


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
        return int.from_bytes(self._transact(Request(frames.READ, i2c_addr, register, 2)), "little")

    def write_word_data(self, i2c_addr: int, register: int, value: int) -> None:
        """Write two bytes to a register, low byte first."""
        data = value.to_bytes(2, "little")
        self._transact(Request(frames.WRITE, i2c_addr, register, data=data))

    def _transact(self, request: Request) -> bytes:
        try:
            self._socket.sendall(frames.pack_request(request))
            packet = self._socket.recv(_LONGEST)
        except TimeoutError:
            self.close()  # a late answer must not be read as the answer to the next request
            raise OSError(errno.ETIMEDOUT, os.strerror(errno.ETIMEDOUT)) from None
        except ConnectionError:
            packet = b""
        # Without a packet, the robot's process has ended.
        answer = frames.unpack_answer(packet) if packet else frames.Answer(errno.EIO)
        if answer.errno:
            raise OSError(answer.errno, os.strerror(answer.errno))
        return answer.data
