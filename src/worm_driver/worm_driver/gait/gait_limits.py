# SPDX-License-Identifier: Apache-2.0
"""Gait as the driver plays it (paper, eq:problem_formulation_gait), and the limits of a robot for gaits."""

import math
from dataclasses import dataclass

from worm_driver.errors import LimitError

FORWARD = 1
REVERSE = -1

_CONTRACTION_SHARES = (0.01, 0.99)  # smallest and largest contraction_share
_RAMP_SHARES = (0.1, 0.5)  # smallest and largest ramp_share
_ROUNDING = 1e-9  # m; tolerance of max_stroke, because 0.02 + 0.07 exceeds 0.09 in floating point


#: Values of `Gait.profile`, the same as in the message worm_msgs/msg/Gait.
COSINE = 0
TRAPEZOID = 1


@dataclass(frozen=True)
class Gait:
    """Gait, in SI units. `GaitLimits.check` checks it against the limits of a robot.

    The message worm_msgs/msg/Gait has the same fields. The defaults are the paper's sinusoid.

    Attributes:
        stroke: S, m.
        frequency: f, cycles per second, Hz.
        direction: FORWARD or REVERSE.
        margin: robustness margin with which the gait was designed, m; it does not change the motion.
        pretension: o, m; smallest contraction during the gait.
        contraction_share: part of a cycle in which the body contracts; in the rest of the cycle it extends.
        profile: COSINE or TRAPEZOID, waveform of the contraction and of the extension.
        ramp_share: part of the duration of the contraction in which a TRAPEZOID accelerates. It decelerates in an
            equally long part at the end. The same parts apply to the extension.
    """

    stroke: float
    frequency: float
    direction: int = FORWARD
    margin: float = 0.0
    pretension: float = 0.0
    contraction_share: float = 0.5
    profile: int = COSINE
    ramp_share: float = 0.25

    def length_change(self, time: float) -> float:
        """Return u_cmd (m, never positive) at a time (s) after the onset."""
        phase = self.frequency * time % 1.0
        if phase < self.contraction_share:
            contracted = self._progress(phase / self.contraction_share)
        else:
            contracted = 1.0 - self._progress(self.extended_share(phase))
        return self.point_of_rest - self.stroke * contracted

    def extended_share(self, phase: float) -> float:
        """Return the elapsed part of the extension at a phase (0 to 1) of a cycle; negative before the extension."""
        return (phase - self.contraction_share) / (1.0 - self.contraction_share)

    def _progress(self, part: float) -> float:
        """Return the covered share of the stroke after a part (0 to 1) of a contraction's or extension's duration."""
        if self.profile == COSINE:
            return 0.5 * (1.0 - math.cos(math.pi * part))
        ramp = self.ramp_share
        if part < ramp:
            return 0.5 * part**2 / (ramp * (1.0 - ramp))
        if part > 1.0 - ramp:
            return 1.0 - 0.5 * (1.0 - part) ** 2 / (ramp * (1.0 - ramp))
        return (part - 0.5 * ramp) / (1.0 - ramp)

    @property
    def point_of_rest(self) -> float:
        """Length change at which every cycle begins and ends, −o, m."""
        return 0.0 - self.pretension  # not -0.0

    @property
    def reach(self) -> float:
        """Largest contraction o + S, m."""
        return self.pretension + self.stroke

    @property
    def peak_speed(self) -> float:
        """Largest commanded speed of the cable, m/s, reached in the shorter one of contraction and extension."""
        slope = math.pi / 2 if self.profile == COSINE else 1.0 / (1.0 - self.ramp_share)
        faster = min(self.contraction_share, 1.0 - self.contraction_share)
        return slope * self.stroke * self.frequency / faster


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
        if not (math.isfinite(gait.frequency) and gait.frequency > 0.0):
            return 1  # `check` rejects the gait.
        return max(1, min(self.max_cycles, math.floor(self.max_duration * gait.frequency)))

    def check(self, gait: Gait, cycles: int) -> None:
        """Check a gait and its number of cycles.

        Raises:
            LimitError: A value is not finite or is outside its limits. The message contains the value.
        """
        ranges = (
            ("stroke", self.min_stroke, self.max_stroke, " m", "limits.max_stroke_m"),
            ("frequency", self.min_frequency, self.max_frequency, " Hz", "limits.max_frequency_hz"),
            ("margin", 0.0, self.max_stroke, " m", "limits.max_stroke_m"),
            ("pretension", 0.0, self.max_stroke, " m", "limits.max_stroke_m"),
            ("contraction_share", *_CONTRACTION_SHARES, "", "worm_msgs/msg/Gait"),
            ("ramp_share", *_RAMP_SHARES, "", "worm_msgs/msg/Gait"),
        )
        for name, low, high, unit, limit in ranges:
            value = getattr(gait, name)
            if not math.isfinite(value):
                raise LimitError(f"the gait's {name} is {value}, not a finite number")
            if not low <= value <= high:
                raise LimitError(
                    f"{name} {value:g}{unit} is outside {low:g} to {high:g}{unit} ({limit})"
                )
        if gait.reach > self.max_stroke + _ROUNDING:
            raise LimitError(
                f"pretension {gait.pretension:g} m and stroke {gait.stroke:g} m contract the body by {gait.reach:g} m; "
                f"the limit is {self.max_stroke:g} m (limits.max_stroke_m)"
            )
        if gait.profile not in (COSINE, TRAPEZOID):
            raise LimitError(f"profile must be 0 (cosine) or 1 (trapezoid), not {gait.profile}")
        if gait.direction not in (FORWARD, REVERSE):
            raise LimitError(f"direction must be 1 (forward) or -1 (reverse), not {gait.direction}")
        if not 1 <= cycles <= self.max_cycles:
            raise LimitError(f"cycles must be 1 to {self.max_cycles}, not {cycles}")
        if cycles / gait.frequency > self.max_duration:
            raise LimitError(
                f"{cycles} cycles at {gait.frequency:g} Hz take {cycles / gait.frequency:.0f} s; a run may take "
                f"{self.max_duration:.0f} s: request at most {math.floor(self.max_duration * gait.frequency)} cycles"
            )
        if gait.peak_speed > self.max_cable_speed:
            highest = gait.stroke * gait.frequency * self.max_cable_speed / gait.peak_speed
            raise LimitError(
                f"the cable would reach {gait.peak_speed:.4f} m/s; the limit is {self.max_cable_speed:.4f} m/s. "
                f"With this waveform, stroke times frequency is at most {highest:.4f} m/s"
            )
