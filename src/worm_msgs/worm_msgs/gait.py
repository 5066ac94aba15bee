# SPDX-License-Identifier: Apache-2.0
"""Gaits: the paper's sinusoid (eq:problem_formulation_gait) and waveforms with further parameters.

`worm_driver.gait` plays them within the limits of a robot, and `worm_model` simulates them.
"""

from __future__ import annotations

import dataclasses
import enum
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final, get_type_hints

from worm_msgs.input_error import InputError

FORWARD: Final = 1
REVERSE: Final = -1

MAX_STROKE = 1.0  # m; a larger stroke is probably in another unit
MAX_FREQUENCY = 20.0  # Hz
MAX_MARGIN = 0.1  # m
MAX_PRETENSION = 1.0  # m
CONTRACTION_SHARE_RANGE = (0.01, 0.99)
RAMP_SHARE_RANGE = (0.1, 0.5)


class GaitError(InputError):
    """A gait is not admissible. The message states the reason."""


def _row(unit: str, meaning: str, default: Any = dataclasses.MISSING) -> Any:
    """Return a field with its unit and meaning as metadata; a field without a default is mandatory."""
    return field(default=default, metadata={"unit": unit, "meaning": meaning})


class Profile(enum.IntEnum):
    """Shape of a half cycle: a half wave of a cosine, or a trapezoidal velocity profile.

    Messages and arrays contain the number; JSON, CSV, YAML and command lines contain the name (``str(profile)``).
    ``Profile(value)`` accepts both, and raises `GaitError` for any other value.
    """

    COSINE = 0
    TRAPEZOID = 1

    @classmethod
    def _missing_(cls, value: object) -> Profile:
        names = {str(profile): profile for profile in cls}
        if isinstance(value, str) and value in names:
            return names[value]
        raise GaitError(f"profile: {value!r} is neither {' nor '.join(names)}")

    def __str__(self) -> str:
        return self.name.lower()


@dataclass(frozen=True)
class Gait:
    """Periodic command of the cable that contracts the body and extends it again.

    The symbols o, S and s are defined below, and p in [0, 1) is the phase of a cycle. The command swings between −o
    and −(o + S):

        u_cmd = −o − S·g(p/s)                        for p < s
        u_cmd = −o − S·(1 − g((p − s)/(1 − s)))      for p ≥ s

    ``profile`` selects g. COSINE is g(q) = (1 − cos πq)/2. TRAPEZOID is the position of a trapezoidal velocity profile,
    which accelerates during the first ``ramp_share`` of the contraction, and of the extension, and decelerates during
    an equal part at their ends. With the defaults the gait is the paper's, u_cmd(t) = −S/2 (1 − cos 2πft).

    The message worm_msgs/msg/Gait has the same fields. Tables, messages, bags and the kernel use these fields by name.
    The default of a new field must describe the gaits that were recorded before the field existed.

    Attributes:
        stroke: S, m.
        frequency: f, Hz.
        direction: FORWARD (+x) or REVERSE (−x, fins flipped).
        margin: robustness margin δ_m, m, which is added to the switching threshold (eq:A1_switch_robust). The nominal
            prediction has the margin 0.
        pretension: o, m, smallest commanded contraction.
        contraction_share: s, part of a cycle in which the body contracts.
        profile: shape of the contraction and of the extension.
        ramp_share: part of the contraction, and of the extension, in which a TRAPEZOID accelerates.

    Raises:
        GaitError: A value is not finite or not in its range.
    """

    stroke: float = _row("m", "contraction stroke")
    frequency: float = _row("Hz", "frequency")
    direction: int = _row("1", "1 forward, -1 reverse", FORWARD)
    margin: float = _row("m", "robustness margin", 0.0)
    pretension: float = _row("m", "pretension of the cable", 0.0)
    contraction_share: float = _row("1", "share of a cycle that contracts", 0.5)
    profile: Profile = _row("1", "shape of contraction and extension", Profile.COSINE)  # noqa: RUF009 - frozen
    ramp_share: float = _row("1", "accelerated share of contraction and extension", 0.25)

    def __post_init__(self) -> None:
        _check("stroke", self.stroke, "m", 0.0, MAX_STROKE)
        _check("frequency", self.frequency, "Hz", 0.0, MAX_FREQUENCY)
        _check_within("margin", self.margin, "m", 0.0, MAX_MARGIN)
        _check_within("pretension", self.pretension, "m", 0.0, MAX_PRETENSION)
        _check_within("contraction_share", self.contraction_share, "", *CONTRACTION_SHARE_RANGE)
        _check_within("ramp_share", self.ramp_share, "", *RAMP_SHARE_RANGE)
        if self.direction not in (FORWARD, REVERSE):
            raise GaitError(
                f"direction: {self.direction} is neither {FORWARD} (forward) nor {REVERSE} (reverse)"
            )
        object.__setattr__(self, "direction", int(self.direction))
        object.__setattr__(self, "profile", Profile(self.profile))

    @property
    def period(self) -> float:
        """Duration of a cycle, s."""
        return 1.0 / self.frequency

    @property
    def point_of_rest(self) -> float:
        """Length change at which every cycle begins and ends, −o, m."""
        return 0.0 - self.pretension  # not -0.0

    @property
    def is_sinusoid(self) -> bool:
        """True for the paper's waveform: no pretension, and two cosine halves of equal duration."""
        shape = self.pretension, self.contraction_share, self.profile
        return shape == (0.0, 0.5, Profile.COSINE)

    @property
    def reach(self) -> float:
        """Largest commanded contraction o + S, m."""
        return self.pretension + self.stroke

    @property
    def peak_speed(self) -> float:
        """Largest commanded speed of the cable in m/s, which occurs in the faster half of the cycle."""
        rate = peak_rate(self.profile, self.contraction_share, self.ramp_share)
        return float(rate) * self.stroke * self.frequency

    def length_change(self, time: float) -> float:
        """Return u_cmd in m (≤ 0) at ``time``, s since the onset. It needs no NumPy, for the driver's control loop."""
        return float(self._command(time, math.cos, min, max))

    def command(self, time: Any) -> Any:
        """Return u_cmd in m for an array of times."""
        import numpy as np  # Imported here, because driver and --help need no NumPy.

        return self._command(np.asarray(time), np.cos, np.minimum, np.maximum)

    def extended_share(self, phase: float) -> float:
        """Return the elapsed part of the extension at a phase (0 to 1) of a cycle; negative before the extension."""
        return (phase - self.contraction_share) / (1.0 - self.contraction_share)

    def _command(self, time: Any, cos: Any, minimum: Any, maximum: Any) -> Any:
        """Return u_cmd in m at one time or at an array of times, with the functions for one or the other."""
        phase, share = self.frequency * time % 1.0, self.contraction_share
        # g is symmetric, g(q) = 1 − g(1 − q), so the extension is a contraction played backwards.
        part = minimum(phase / share, (1.0 - phase) / (1.0 - share))
        if self.profile is Profile.COSINE:
            progress = 0.5 * (1.0 - cos(math.pi * part))
        else:
            ramp = self.ramp_share
            slow = maximum(ramp - part, 0.0) ** 2 - maximum(part - (1.0 - ramp), 0.0) ** 2
            progress = (part - 0.5 * ramp + 0.5 * slow / ramp) / (1.0 - ramp)
        return self.point_of_rest - self.stroke * progress


def peak_rate(profile: Any, contraction_share: Any, ramp_share: Any) -> Any:
    """Return the largest commanded cable speed of a waveform, or of arrays of them, by stroke times frequency."""
    is_cosine = profile == Profile.COSINE
    peak = is_cosine * (0.5 * math.pi) + (1.0 - is_cosine) / (1.0 - ramp_share)
    return peak / (0.5 - abs(contraction_share - 0.5))


def _check(name: str, value: float, unit: str, low: float, high: float) -> None:
    if not (math.isfinite(value) and low < value <= high):
        raise GaitError(
            f"{name}: {value} {unit}; it must be above {low:g} and at most {high:g} {unit}"
        )


def _check_within(name: str, value: float, unit: str, low: float, high: float) -> None:
    if not low <= value <= high:
        unit = f" {unit}" if unit else ""
        raise GaitError(f"{name}: {value}{unit} is not between {low:g} and {high:g}{unit}")


GAIT_UNITS: Mapping[str, str] = {row.name: row.metadata["unit"] for row in dataclasses.fields(Gait)}
GAIT_MEANINGS: Mapping[str, str] = {
    row.name: row.metadata["meaning"] for row in dataclasses.fields(Gait)
}
GAIT_DEFAULTS: Mapping[str, Any] = {
    row.name: row.default
    for row in dataclasses.fields(Gait)
    if row.default is not dataclasses.MISSING
}
GAIT_TYPES: Mapping[str, Any] = get_type_hints(Gait)
#: columns of a table, by field: the name of the field, followed by its unit unless the unit is 1
GAIT_COLUMNS: Mapping[str, str] = {
    name: name if unit == "1" else f"{name}_{unit}" for name, unit in GAIT_UNITS.items()
}
#: fields that determine u_cmd
WAVEFORM = tuple(name for name in GAIT_UNITS if name not in ("direction", "margin"))
#: fields of the waveform except stroke and frequency
SHAPE = tuple(name for name in WAVEFORM if name in GAIT_DEFAULTS)


def gait_of(source: Any) -> Gait:
    """Return a gait whose fields are the items of a mapping, or the attributes of a message or a record.

    Stroke and frequency are mandatory; any other field that the source lacks has its default. Raises `GaitError` if a
    mandatory field is missing, or if a value is not admissible.
    """
    if not isinstance(source, Mapping):
        source = {name: getattr(source, name) for name in GAIT_UNITS if hasattr(source, name)}
    missing = [name for name in GAIT_UNITS if name not in GAIT_DEFAULTS and name not in source]
    if missing:
        raise GaitError(f"{missing[0]} is missing")
    return Gait(**{name: _value(name, source[name]) for name in GAIT_UNITS if name in source})


def _value(name: str, value: Any) -> Any:
    """Return a value of a field, as float if the field is one. `Gait` checks and converts the other fields."""
    if GAIT_TYPES[name] is not float:
        return value
    try:
        return float(value)
    except (TypeError, ValueError, OverflowError):
        raise GaitError(f"{name}: {value!r} is not a number") from None
