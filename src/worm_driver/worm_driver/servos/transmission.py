# SPDX-License-Identifier: Apache-2.0
"""Servo angle to cable length and back.

Every servo's own position 0 is its home: the cable at its initial length, delta L = 0. Homing sets the servo's homing
offset so, hence the home lives in the servo and not in a file beside it.
"""

import math
from dataclasses import dataclass

from worm_driver.errors import ConfigurationError, LimitError
from worm_driver.servos.registers import EXTENDED_POSITION_LIMIT, TICKS_PER_TURN


@dataclass(frozen=True)
class Spool:
    """A cable servo's spool.

    Attributes:
        servo: id on the bus.
        sign: +1 when rising ticks wind the cable up (shorten the body), -1 when they pay it out.
        radius: m, from the spool's axis to the middle of the cable.
    """

    servo: int
    sign: int
    radius: float

    def __post_init__(self) -> None:
        if self.sign not in (1, -1):
            raise ConfigurationError(
                f"sign of cable servo {self.servo} must be 1 or -1, not {self.sign}"
            )
        if not (math.isfinite(self.radius) and 0.001 <= self.radius <= 0.1):
            raise ConfigurationError(
                f"spool radius of cable servo {self.servo} must be 0.001 to 0.1 m, not {self.radius:g}"
            )

    def ticks(self, length_change: float) -> int:
        """Position (ticks from home) that gives a change of length (m, contraction is negative).

        Raises LimitError: not finite, or further than the servo counts.
        """
        if not math.isfinite(length_change):
            raise LimitError(
                f"cable servo {self.servo}: length change {length_change} is no number"
            )
        ticks = round(-self.sign * length_change / self.radius * TICKS_PER_TURN / (2 * math.pi))
        if abs(ticks) > EXTENDED_POSITION_LIMIT:
            raise LimitError(
                f"cable servo {self.servo}: length change {length_change:g} m is {ticks} ticks from home, "
                f"the servo counts {EXTENDED_POSITION_LIMIT}"
            )
        return ticks

    def length_change(self, ticks: float) -> float:
        """Change of length (m) at a position (ticks from home)."""
        return -self.sign * ticks * 2 * math.pi / TICKS_PER_TURN * self.radius

    def speed(self, shaft_speed: float) -> float:
        """Cable speed (m/s, without sign) at a shaft speed (rad/s)."""
        return abs(shaft_speed) * self.radius


@dataclass(frozen=True)
class Fin:
    """A fin servo and its two positions.

    Attributes:
        servo: id on the bus.
        forward_angle: rad, servo position with which the robot goes forward.
        reverse_angle: rad, the other one.
    """

    servo: int
    forward_angle: float
    reverse_angle: float

    def __post_init__(self) -> None:
        for angle in (self.forward_angle, self.reverse_angle):
            if not 0.0 <= angle < 2 * math.pi:
                raise ConfigurationError(
                    f"angles of fin servo {self.servo} must lie in [0, 2 pi) rad, not {angle:g}"
                )

    def ticks(self, direction: int) -> int:
        """Position (ticks) for a direction, 1 forward or -1 reverse."""
        angle = self.forward_angle if direction > 0 else self.reverse_angle
        return round(angle * TICKS_PER_TURN / (2 * math.pi)) % TICKS_PER_TURN
