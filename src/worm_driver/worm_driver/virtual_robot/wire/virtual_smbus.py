# SPDX-License-Identifier: Apache-2.0
"""A stand-in for smbus2.SMBus whose transactions cross to the virtual robot's process.

Register reads and writes and nothing higher. As with the kernel, a word's first byte on the wire is
its low byte, and a device that does not acknowledge is OSError(EREMOTEIO).
"""

import errno
import os
import socket
from types import TracebackType

from worm_driver.virtual_robot.wire import smbus_frames as frames
from worm_driver.virtual_robot.wire.smbus_frames import Answer, Request

_TIMEOUT = 60.0  # s; a bus that hangs is the robot's to tell, in its own time: here only a robot that hangs ends it


class SocketSMBus:
    """smbus2.SMBus' calls with its signatures, on the socket of a virtual robot.

    i2c_addr is the 7-bit address; register, value and data are bytes or words as in smbus2; force
    is taken and ignored, there is no kernel driver to override. All calls raise OSError.
    """

    def __init__(
        self,
        bus: str | None = None,
        force: bool = False,  # noqa: FBT001, FBT002 (smbus2's signature)
    ) -> None:
        """Opens the socket at the path `bus`, unless it is None."""
        self.force = force
        self._socket: socket.socket | None = None
        self._buffer = b""
        if bus is not None:
            self.open(bus)

    def __enter__(self) -> "SocketSMBus":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def open(self, bus: str) -> None:
        """Connects to a path; FileNotFoundError or ConnectionRefusedError without a robot there."""
        connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        connection.settimeout(_TIMEOUT)
        try:
            connection.connect(bus)
        except OSError:
            connection.close()
            raise
        self.close()
        self._socket = connection

    def close(self) -> None:
        """Ends the connection; may be repeated."""
        if self._socket is not None:
            self._socket.close()
        self._socket = None
        self._buffer = b""

    def read_word_data(self, i2c_addr: int, register: int, force: bool | None = None) -> int:  # noqa: ARG002, FBT001
        """Two bytes of a register, the first one taken for the low byte."""
        return int.from_bytes(self._transact(Request(frames.READ, i2c_addr, register, 2)), "little")

    def write_word_data(
        self,
        i2c_addr: int,
        register: int,
        value: int,
        force: bool | None = None,  # noqa: ARG002, FBT001
    ) -> None:
        """Two bytes to a register, the low byte first."""
        data = value.to_bytes(2, "little")
        self._transact(Request(frames.WRITE, i2c_addr, register, data=data))

    def _transact(self, request: Request) -> bytes:
        if self._socket is None:
            raise OSError(errno.EBADF, os.strerror(errno.EBADF))
        try:
            self._socket.sendall(frames.pack_request(request))
            answer = self._receive(self._socket)
        except TimeoutError:
            self.close()  # a late answer must not be taken for the next one's
            raise OSError(errno.ETIMEDOUT, os.strerror(errno.ETIMEDOUT)) from None
        except ConnectionError as error:
            raise OSError(errno.EIO, os.strerror(errno.EIO)) from error
        if answer.errno:
            raise OSError(answer.errno, os.strerror(answer.errno))
        return answer.data

    def _receive(self, connection: socket.socket) -> Answer:
        while True:
            answer, self._buffer = frames.take_answer(self._buffer)
            if answer is not None:
                return answer
            received = connection.recv(256)
            if not received:
                raise ConnectionResetError
            self._buffer += received
