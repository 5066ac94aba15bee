# SPDX-License-Identifier: Apache-2.0
"""I2C bus with one INA219: executes transactions and returns bytes or an error number."""

import errno

from worm_driver.virtual_robot.wire import faults
from worm_driver.virtual_robot.wire import smbus_frames as frames
from worm_driver.virtual_robot.wire.faults import FaultBoard
from worm_driver.virtual_robot.wire.ina219_chip import Ina219
from worm_driver.virtual_robot.wire.smbus_frames import Answer, Request

_RELEASED = 0xFF  # value of a bus that no device drives


class I2cLine:
    """I2C bus that acknowledges only the chip's address."""

    def __init__(self, chip: Ina219, address: int, board: FaultBoard) -> None:
        self._chip = chip
        self._address = address
        self._board = board

    def transact(self, request: Request, time: float) -> Answer:
        """Execute a transaction at a time (s)."""
        if hang := self._board.consume(faults.I2C_TIMEOUT, time):
            return Answer(errno.ETIMEDOUT, delay=hang.value)
        if request.address != self._address or self._board.consume(faults.I2C_NACK, time):
            return Answer(errno.EREMOTEIO)
        if request.operation == frames.WRITE:
            # The chip accepts exactly two bytes per register, most significant byte first.
            if len(request.data) == 2:
                self._chip.write(request.register, int.from_bytes(request.data, "big"))
            return Answer(0)
        value = self._chip.read(request.register).to_bytes(2, "big")
        padded = value + bytes([_RELEASED]) * max(request.length - 2, 0)
        return Answer(0, padded[: request.length])
