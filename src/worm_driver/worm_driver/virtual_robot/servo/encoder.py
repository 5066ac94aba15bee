# SPDX-License-Identifier: Apache-2.0
"""Conversion between shaft position and position registers: reverse mode, folding, homing offset.

Folding removes the whole turns from the position registers, for example when the servo boots. The shaft position
continues to count all turns (unfolded).
"""

import math
from dataclasses import dataclass

from worm_driver.virtual_robot.servo.control_table import PULSES_PER_TURN


@dataclass(frozen=True)
class Encoder:
    """Encoder of a servo.

    Attributes:
        direction: 1; -1 in reverse mode.
        folded_turns: number of turns that folding has removed.
        homing_offset: value of the register homing_offset, pulses.
    """

    direction: int
    folded_turns: int
    homing_offset: int

    def raw(self, shaft: float) -> int:
        """Return the register value for a shaft position (pulses, unfolded)."""
        counted = math.floor(self.direction * shaft) - self.folded_turns * PULSES_PER_TURN
        return counted + self.homing_offset

    def shaft(self, raw: int) -> float:
        """Return the centre of the range of shaft positions (pulses, unfolded) that have a register value."""
        counted = raw - self.homing_offset + self.folded_turns * PULSES_PER_TURN
        return self.direction * (counted + 0.5)


def turns_of(shaft: float, direction: int) -> int:
    """Return the number of turns that folding removes at a shaft position (pulses, unfolded)."""
    return math.floor(direction * shaft) // PULSES_PER_TURN
