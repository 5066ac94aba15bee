# SPDX-License-Identifier: Apache-2.0
"""How position registers count a shaft: reverse mode, folding to one turn, homing offset."""

import math
from dataclasses import dataclass

from worm_driver.virtual_robot.servo.control_table import PULSES_PER_TURN


@dataclass(frozen=True)
class Encoder:
    """direction: -1 in reverse mode; folded_turns: turns lost at the last folding; offset: pulses."""

    direction: int
    folded_turns: int
    homing_offset: int

    def raw(self, shaft: float) -> int:
        """The register's value for a position of the shaft (pulses, unfolded)."""
        counted = math.floor(self.direction * shaft) - self.folded_turns * PULSES_PER_TURN
        return counted + self.homing_offset

    def shaft(self, raw: int) -> float:
        """The middle of the shaft's positions (pulses, unfolded) that read as a value."""
        counted = raw - self.homing_offset + self.folded_turns * PULSES_PER_TURN
        return self.direction * (counted + 0.5)


def turns_of(shaft: float, direction: int) -> int:
    """Whole turns of a position (pulses) as counted in a direction: what folding takes away."""
    return math.floor(direction * shaft) // PULSES_PER_TURN
