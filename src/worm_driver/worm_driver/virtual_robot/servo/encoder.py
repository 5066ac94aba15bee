# SPDX-License-Identifier: Apache-2.0
"""Conversion between shaft position and position registers: reverse mode, folding, homing offset."""

import math
from dataclasses import dataclass

from worm_driver.virtual_robot.servo.control_table import PULSES_PER_TURN


@dataclass(frozen=True)
class Encoder:
    """Encoder. direction: -1 in reverse mode; folded_turns: turns lost at the last folding; homing_offset: pulses."""

    direction: int
    folded_turns: int
    homing_offset: int

    def raw(self, shaft: float) -> int:
        """Return the register value for a shaft position (pulses, unfolded)."""
        counted = math.floor(self.direction * shaft) - self.folded_turns * PULSES_PER_TURN
        return counted + self.homing_offset

    def shaft(self, raw: int) -> float:
        """Return the centre of the shaft positions (pulses, unfolded) that give a register value."""
        counted = raw - self.homing_offset + self.folded_turns * PULSES_PER_TURN
        return self.direction * (counted + 0.5)


def turns_of(shaft: float, direction: int) -> int:
    """Return the whole turns of a position (pulses) in a direction, which folding removes."""
    return math.floor(direction * shaft) // PULSES_PER_TURN
