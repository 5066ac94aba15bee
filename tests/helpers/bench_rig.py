# SPDX-License-Identifier: Apache-2.0
"""Servo bus on virtual servos that hear only their own baud rate, with a record of the instructions."""

from collections.abc import Callable

from driver_rig import Clock, SimulatedPort, Wire

from worm_driver.servos.servo_bus import ServoBus
from worm_driver.virtual_robot.virtual_bus import Transmission
from worm_driver.virtual_robot.wire.packet import Instruction, InstructionReader, Packet

#: instructions that change nothing
READING = {Instruction.PING, Instruction.READ, Instruction.SYNC_READ}


class _RatedPort(SimulatedPort):
    """Port that can be opened again with another baud rate."""

    def setupPort(self, cflag_baud: int) -> bool:
        return True


class Bench:
    """Servo bus, its clock, and the instructions that were sent.

    Args:
        receive: returns the answers to bytes at a time (s) and baud rate (bit/s), as `VirtualRobot.receive`.
    """

    def __init__(self, receive: Callable[[bytes, float, int], list[Transmission]]):
        self.clock = Clock()
        self.sent: list[Packet] = []
        self._receive = receive
        self._reader = InstructionReader(1.0)
        self._port = _RatedPort(Wire(self.clock, self._answer), self.clock)
        self.bus = ServoBus(self._port)

    def _answer(self, data: bytes, now: float) -> list[tuple[float, bytes]]:
        self.sent += self._reader.feed(data, now)
        return [(t.time, t.data) for t in self._receive(data, now, self._port.baudrate)]

    @property
    def written(self) -> list[Packet]:
        """Instructions that change something."""
        return [packet for packet in self.sent if packet.instruction not in READING]
