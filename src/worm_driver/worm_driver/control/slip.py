# SPDX-License-Identifier: Apache-2.0
"""Comparison of a servo's positions with its own speed, to detect positions that drift while the shaft does not."""

import math
from dataclasses import dataclass

from worm_driver.servos.registers import TICKS_PER_TURN
from worm_driver.servos.servo_state import SILENT, ServoState

#: Time constant with which a slip is forgotten, s. It bounds the effect of the resolution of the speed (16 ticks/s).
_FORGOTTEN = 5.0
#: Slip beyond which the positions are not confirmed, ticks.
_LARGEST = 100.0
#: Period of the servo's own clock (realtime_tick), s.
_TICK_WRAP = 32.768


@dataclass(frozen=True)
class Slip:
    """Motion that the positions of a servo show beyond the integral of its speed.

    Attributes:
        ticks: the slip, ticks.
        last: last state that was not SILENT.
    """

    ticks: float = 0.0
    last: ServoState = SILENT

    @property
    def confirms(self) -> bool:
        """True if the speed confirms the positions."""
        return abs(self.ticks) <= _LARGEST

    def after(self, state: ServoState) -> "Slip":
        """Return the slip after a further state."""
        if state is SILENT:
            return self
        if self.last is SILENT:
            return Slip(self.ticks, state)
        elapsed = (state.tick - self.last.tick) % _TICK_WRAP
        speed = (state.velocity + self.last.velocity) / 2
        turned = speed * elapsed / math.tau * TICKS_PER_TURN
        slip = self.ticks + state.ticks - self.last.ticks - turned
        return Slip(slip * math.exp(-elapsed / _FORGOTTEN), state)
