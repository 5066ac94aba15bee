# SPDX-License-Identifier: Apache-2.0
"""Fields in which a person enters a gait, and the reasons, in the units of the fields, why a gait cannot run."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

from worm_msgs import gait as limits_of_gaits
from worm_msgs.gait import GAIT_DEFAULTS, Gait, Profile


@dataclass(frozen=True)
class GaitField:
    """Field of a gait: its name and unit on the page, the factor from the SI unit to this unit, and its range (SI)."""

    label: str
    scale: float
    unit: str
    low: float
    high: float

    @property
    def title(self) -> str:
        """Name with the unit."""
        return f"{self.label}, {self.unit}" if self.unit else self.label

    def text(self, value: float) -> str:
        """Return a value (SI) in the unit of the page, with the unit."""
        return f"{self.scale * value:.4g} {self.unit}".rstrip()


FIELDS: Mapping[str, GaitField] = {
    "stroke": GaitField("stroke", 1e3, "mm", 0.0, limits_of_gaits.MAX_STROKE),
    "frequency": GaitField("frequency", 1.0, "Hz", 0.0, limits_of_gaits.MAX_FREQUENCY),
    "margin": GaitField("margin", 1e3, "mm", 0.0, limits_of_gaits.MAX_MARGIN),
    "pretension": GaitField("pretension", 1e3, "mm", 0.0, limits_of_gaits.MAX_PRETENSION),
    "contraction_share": GaitField(
        "contraction share", 1.0, "", *limits_of_gaits.CONTRACTION_SHARE_RANGE
    ),
    "ramp_share": GaitField("ramp share", 1.0, "", *limits_of_gaits.RAMP_SHARE_RANGE),
}
DEFAULTS = {name: GAIT_DEFAULTS.get(name, math.nan) for name in FIELDS}
_NOT_ZERO = ("stroke", "frequency")


@dataclass(frozen=True)
class DriverLimits:
    """Limits of the driver for stroke plus pretension (m), frequency (Hz) and speed of the cable (m/s)."""

    max_stroke: float = math.inf
    max_frequency: float = math.inf
    max_cable_speed: float = math.inf

    def obstacle(self, gait: Gait) -> str:
        """Return the reason why the driver would reject a gait; empty if there is none."""
        stroke, frequency = FIELDS["stroke"], FIELDS["frequency"]
        if gait.reach > self.max_stroke + 1e-9:
            return (
                f"stroke {stroke.text(gait.stroke)} and pretension {stroke.text(gait.pretension)} are together more "
                f"than the driver's limit of {stroke.text(self.max_stroke)}"
            )
        if gait.frequency > self.max_frequency:
            return (
                f"frequency {frequency.text(gait.frequency)} is more than the driver's limit of "
                f"{frequency.text(self.max_frequency)}"
            )
        if gait.peak_speed > self.max_cable_speed:
            return (
                f"the cable would reach {1e3 * gait.peak_speed:.4g} mm/s, more than the driver's limit of "
                f"{1e3 * self.max_cable_speed:.4g} mm/s: lower stroke or frequency"
            )
        return ""


def field_error(values: Mapping[str, float]) -> str:
    """Return what is wrong with the first inadmissible value (SI; NaN: empty field); empty if all are admissible."""
    for name, field in FIELDS.items():
        value = values[name]
        if math.isnan(value):
            return f"{field.label}: enter a number"
        if not field.low <= value <= field.high or (name in _NOT_ZERO and value == 0.0):
            least = f"{'more than ' * (name in _NOT_ZERO)}{field.scale * field.low:g}"
            return (
                f"{field.label} is {field.text(value)}: enter {least} to {field.text(field.high)}"
            )
    return ""


def edited(
    gait: Gait | None, values: Mapping[str, float], direction: int, profile: Profile
) -> Gait:
    """Return the gait of the fields. ``values`` are admissible; those of unchanged fields may be missing from it.

    The field of an unchanged value shows fewer digits than the gait has.
    """
    if gait is None:
        return Gait(**values, direction=direction, profile=profile)
    return replace(gait, **values, direction=direction, profile=profile)
