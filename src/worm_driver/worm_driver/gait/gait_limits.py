# SPDX-License-Identifier: Apache-2.0
"""A gait as the driver plays it (paper, eq:problem_formulation_gait), and what the robot can bear."""

import math
from dataclasses import dataclass, fields

from worm_driver.errors import LimitError

FORWARD = 1
REVERSE = -1


@dataclass(frozen=True)
class Gait:
    """A sinusoidal gait; SI. Nothing is checked here, as limits belong to a robot: see GaitLimits."""

    stroke: float
    frequency: float
    direction: int = FORWARD
    margin: float = 0.0
    pretension: float = 0.0
    contraction_share: float = 0.5
    profile: int = 0
    ramp_share: float = 0.25

    def length_change(self, time: float) -> float:
        """u_cmd (m, never positive) at a time (s) after the onset."""
        return -self.stroke / 2 * (1.0 - math.cos(2 * math.pi * self.frequency * time))

    @property
    def peak_speed(self) -> float:
        """Largest speed of the cable, m/s."""
        return math.pi * self.frequency * self.stroke


@dataclass(frozen=True)
class GaitLimits:
    """What may be asked of a robot; SI.

    Attributes:
        max_stroke: m.
        max_frequency: Hz.
        max_cable_speed: m/s, already the least of the parameter and of the servos' velocity limits.
        max_cycles: of one run.
        min_stroke: m, a few steps of the encoder.
        min_frequency: Hz; a cancelled gait plays its cycle to the end, so a cancel takes at most 1 / min_frequency.
        max_duration: s, of one run.
    """

    max_stroke: float
    max_frequency: float
    max_cable_speed: float
    max_cycles: int = 1000
    min_stroke: float = 1e-3
    min_frequency: float = 0.02
    max_duration: float = 7200.0

    def most_cycles(self, gait: Gait) -> int:
        """Of one run, at most; at least 1."""
        if not (math.isfinite(gait.frequency) and gait.frequency > 0.0):
            return 1  # check says what is wrong with the gait
        return max(1, min(self.max_cycles, math.floor(self.max_duration * gait.frequency)))

    def check(self, gait: Gait, cycles: int) -> None:
        """Raises LimitError, which says what is wrong and what would be right."""
        ranges = (
            ("stroke", self.min_stroke, self.max_stroke, "m", "limits.max_stroke_m"),
            ("frequency", self.min_frequency, self.max_frequency, "Hz", "limits.max_frequency_hz"),
            ("margin", 0.0, self.max_stroke, "m", "limits.max_stroke_m"),
        )
        for name, low, high, unit, limit in ranges:
            value = getattr(gait, name)
            if not math.isfinite(value):
                raise LimitError(f"the gait's {name} is {value}, not a number that can be played")
            if not low <= value <= high:
                raise LimitError(
                    f"{name} {value:g} {unit} is outside {low:g} to {high:g} {unit} ({limit})"
                )
        for row in fields(Gait)[-4:]:  # the waveform
            if getattr(gait, row.name) != row.default:
                raise LimitError(
                    f"{row.name} {getattr(gait, row.name)} cannot be played: this driver plays {row.default}"
                )
        if gait.direction not in (FORWARD, REVERSE):
            raise LimitError(f"direction must be 1 (forward) or -1 (reverse), not {gait.direction}")
        if not 1 <= cycles <= self.max_cycles:
            raise LimitError(f"cycles must be 1 to {self.max_cycles}, not {cycles}")
        if cycles / gait.frequency > self.max_duration:
            raise LimitError(
                f"{cycles} cycles at {gait.frequency:g} Hz take {cycles / gait.frequency:.0f} s, a run at most "
                f"{self.max_duration:.0f} s: ask for {math.floor(self.max_duration * gait.frequency)} cycles"
            )
        if gait.peak_speed > self.max_cable_speed:
            raise LimitError(
                f"the cable would reach {gait.peak_speed:.4f} m/s, the robot's limit is "
                f"{self.max_cable_speed:.4f} m/s: stroke times frequency at most "
                f"{self.max_cable_speed / math.pi:.4f} m/s"
            )
