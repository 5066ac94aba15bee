# SPDX-License-Identifier: Apache-2.0
"""Conversion between shaft position and position registers: reverse mode, folding, homing offset.

Folding removes the whole turns from the position registers, for example when the servo boots.
"""

import math
from dataclasses import dataclass

from worm_driver.virtual_robot.servo.control_table import PULSES_PER_TURN


@dataclass(frozen=True)
class Encoder:
    """Encoder. direction: -1 in reverse mode; folded_turns: turns removed by folding; homing_offset: pulses."""

    direction: int
    folded_turns: int
    homing_offset: int

    def raw(self, shaft: float) -> int:
        """Return the register value for a shaft position (pulses, unfolded)."""
        counted = math.floor(self.direction * shaft) - self.folded_turns * PULSES_PER_TURN
        return counted + self.homing_offset

    def shaft(self, raw: int) -> float:
        """Return the centre of the range of shaft positions (pulses, unfolded) with a register value."""
        counted = raw - self.homing_offset + self.folded_turns * PULSES_PER_TURN
        return self.direction * (counted + 0.5)


def turns_of(shaft: float, direction: int) -> int:
    """Return the number of turns that folding removes. shaft: pulses, unfolded; direction: -1 in reverse mode."""
    return math.floor(direction * shaft) // PULSES_PER_TURN
