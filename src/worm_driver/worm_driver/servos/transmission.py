# SPDX-License-Identifier: Apache-2.0
"""Conversion between servo angle and cable length.

Position 0 of a cable servo is its home: the body has its initial length, ΔL = 0. Homing writes the register
homing_offset, so the home is stored in the servo and not in a file.
"""

import math
from dataclasses import dataclass

from worm_driver.driver_errors import ConfigurationError, RejectedError
from worm_driver.servos.registers import EXTENDED_POSITION_LIMIT, TICKS_PER_TURN


@dataclass(frozen=True)
class Spool:
    """Spool of a cable servo.

    Attributes:
        servo: id on the bus.
        sign: +1 if rising ticks wind the cable up (shorten the body), -1 if they pay it out.
        radius: distance from the spool's axis to the middle of the cable, m.
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
        """Return the position (ticks from home) for a length change (m, contraction is negative)."""
        if not math.isfinite(length_change):
            raise RejectedError(
                f"cable servo {self.servo}: length change {length_change} is not a finite number"
            )
        ticks = round(-self.sign * length_change / self.radius * TICKS_PER_TURN / (2 * math.pi))
        if abs(ticks) > EXTENDED_POSITION_LIMIT:
            raise RejectedError(
                f"cable servo {self.servo}: length change {length_change:g} m is {ticks} ticks from home, "
                f"the servo counts at most {EXTENDED_POSITION_LIMIT}"
            )
        return ticks

    def length_change(self, ticks: float) -> float:
        """Return the length change (m) at a position (ticks from home)."""
        return -self.sign * ticks * 2 * math.pi / TICKS_PER_TURN * self.radius

    def speed(self, shaft_speed: float) -> float:
        """Return the absolute cable speed (m/s) at a shaft speed (rad/s)."""
        return abs(shaft_speed) * self.radius


@dataclass(frozen=True)
class Fin:
    """Fin servo and its two positions.

    Attributes:
        servo: id on the bus.
        forward_angle: servo position for forward gaits, rad.
        reverse_angle: servo position for reverse gaits, rad.
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
        """Return the position (ticks) for a direction, 1 for forward or -1 for reverse."""
        angle = self.forward_angle if direction > 0 else self.reverse_angle
        return round(angle * TICKS_PER_TURN / (2 * math.pi)) % TICKS_PER_TURN
