# SPDX-License-Identifier: Apache-2.0
"""A stand-in for smbus2.SMBus whose transactions cross to the virtual robot's process.

As with the kernel, a word's first byte on the wire is its low byte, and a device that does not acknowledge is
OSError(EREMOTEIO).
"""

import errno
import os
import socket

from worm_driver.virtual_robot.wire import smbus_frames as frames
from worm_driver.virtual_robot.wire.smbus_frames import Request

_TIMEOUT = 60.0  # s; a bus that hangs is the robot's to tell, in its own time: here only a robot that hangs ends it
_LONGEST = 512  # bytes of an answer, of which 255 may be data


class SocketSMBus:
    """What is used of smbus2.SMBus (power/i2c.py), on the socket of a virtual robot; all calls raise OSError.

    i2c_addr is the 7-bit address; register and value are a byte and a word.
    """

    def __init__(self, bus: str) -> None:
        """Connects to a path; FileNotFoundError or ConnectionRefusedError without a robot there."""
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._socket.settimeout(_TIMEOUT)
        try:
            self._socket.connect(bus)
        except OSError:
            self.close()
            raise

    def close(self) -> None:
        """Ends the connection; may be repeated."""
        self._socket.close()

    def read_word_data(self, i2c_addr: int, register: int) -> int:
        """Two bytes of a register, the first one taken for the low byte."""
        return int.from_bytes(self._transact(Request(frames.READ, i2c_addr, register, 2)), "little")

    def write_word_data(self, i2c_addr: int, register: int, value: int) -> None:
        """Two bytes to a register, the low byte first."""
        data = value.to_bytes(2, "little")
        self._transact(Request(frames.WRITE, i2c_addr, register, data=data))

    def _transact(self, request: Request) -> bytes:
        try:
            self._socket.sendall(frames.pack_request(request))
            packet = self._socket.recv(_LONGEST)
        except TimeoutError:
            self.close()  # a late answer must not be taken for the next one's
            raise OSError(errno.ETIMEDOUT, os.strerror(errno.ETIMEDOUT)) from None
        except ConnectionError:
            packet = b""
        # a robot that is gone leaves nothing to read
        answer = frames.unpack_answer(packet) if packet else frames.Answer(errno.EIO)
        if answer.errno:
            raise OSError(answer.errno, os.strerror(answer.errno))
        return answer.data
