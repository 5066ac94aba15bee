# SPDX-License-Identifier: Apache-2.0
"""Servo bus on virtual servos that hear only their own baud rate, with a record of the instructions."""

from collections.abc import Callable

from driver_rig import Clock, SimulatedPort, Wire

from worm_driver.servos.servo_bus import ServoBus
from worm_driver.virtual_robot.virtual_bus import Transmission
from worm_driver.virtual_robot.wire.packet import Instruction, InstructionReader, Packet

#: instructions that change nothing
READING = {Instruction.PING, Instruction.READ, Instruction.SYNC_READ}


class Bench:
    """Servo bus and its clock.

    Args:
        receive: returns the answers to bytes at a time (s) and baud rate (bit/s), as `VirtualRobot.receive`.
    """

    def __init__(self, receive: Callable[[bytes, float, int], list[Transmission]]):
        def answer(data: bytes, now: float) -> list[tuple[float, bytes]]:
            return [(t.time, t.data) for t in receive(data, now, port.baudrate)]

        self.clock = Clock()
        self._wire = Wire(self.clock, answer)
        port = SimulatedPort(self._wire, self.clock)
        self.bus = ServoBus(port)

    @property
    def written(self) -> list[Packet]:
        """Instructions that change something."""
        sent = InstructionReader(1.0).feed(b"".join(self._wire.sent), self.clock.now)
        return [packet for packet in sent if packet.instruction not in READING]
