# SPDX-License-Identifier: Apache-2.0
"""Limits of a robot for gaits."""

import math
from dataclasses import dataclass

from worm_driver.driver_errors import RejectedError
from worm_msgs.gait import Gait

_ROUNDING = 1e-9  # m; tolerance of max_stroke, because 0.02 + 0.07 exceeds 0.09 in floating point


@dataclass(frozen=True)
class GaitLimits:
    """Limits of a robot for gaits, SI.

    Attributes:
        max_stroke: largest sum of stroke and pretension, m.
        max_frequency: highest frequency, Hz.
        max_cable_speed: largest peak speed of the cable, m/s.
        max_cycles: largest number of cycles of one run.
        min_stroke: smallest stroke, m.
        min_frequency: lowest frequency, Hz. It bounds the time in which a cancelled gait completes its cycle.
        max_duration: longest total duration of the cycles of one run, s.
    """

    max_stroke: float
    max_frequency: float
    max_cable_speed: float
    max_cycles: int = 1000
    min_stroke: float = 1e-3
    min_frequency: float = 0.02
    max_duration: float = 7200.0

    def most_cycles(self, gait: Gait) -> int:
        """Return the largest number of cycles that a run with a gait may have, at least 1."""
        return max(1, min(self.max_cycles, math.floor(self.max_duration * gait.frequency)))

    def check(self, gait: Gait, cycles: int) -> None:
        """Check a gait and its number of cycles."""
        ranges = (
            ("stroke", self.min_stroke, self.max_stroke, " m", "limits.max_stroke_m"),
            ("frequency", self.min_frequency, self.max_frequency, " Hz", "limits.max_frequency_hz"),
            ("margin", 0.0, self.max_stroke, " m", "limits.max_stroke_m"),
            ("pretension", 0.0, self.max_stroke, " m", "limits.max_stroke_m"),
        )
        for name, low, high, unit, limit in ranges:
            value = getattr(gait, name)
            if not low <= value <= high:
                raise RejectedError(
                    f"{name} {value:g}{unit} is outside {low:g} to {high:g}{unit} ({limit})"
                )
        if gait.reach > self.max_stroke + _ROUNDING:
            raise RejectedError(
                f"pretension {gait.pretension:g} m and stroke {gait.stroke:g} m contract the body by {gait.reach:g} m; "
                f"the limit is {self.max_stroke:g} m (limits.max_stroke_m)"
            )
        if not 1 <= cycles <= self.max_cycles:
            raise RejectedError(f"cycles must be 1 to {self.max_cycles}, not {cycles}")
        if cycles / gait.frequency > self.max_duration:
            raise RejectedError(
                f"{cycles} cycles at {gait.frequency:g} Hz take {cycles / gait.frequency:.0f} s; a run may take "
                f"{self.max_duration:.0f} s: request at most {math.floor(self.max_duration * gait.frequency)} cycles"
            )
        if gait.peak_speed > self.max_cable_speed:
            highest = gait.stroke * gait.frequency * self.max_cable_speed / gait.peak_speed
            raise RejectedError(
                f"the cable would reach {gait.peak_speed:.4f} m/s; the limit is {self.max_cable_speed:.4f} m/s. "
                f"With this waveform, stroke times frequency is at most {highest:.4f} m/s"
            )
