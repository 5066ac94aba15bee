# SPDX-License-Identifier: Apache-2.0
"""Fields in which a person enters a gait, and the reasons, in their names and units, why a gait cannot run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from worm_msgs import gait as limits_of_gaits
from worm_msgs.gait import Gait

#: parameters of the driver with its limits for `rejection`
LIMITS = ("limits.max_stroke_m", "limits.max_frequency_hz", "limits.max_cable_speed_m_per_s")
_ROUNDING = 1e-9


class GaitField(NamedTuple):
    """Field of a gait: its name with its unit, the factor from the SI unit to this unit, and its range in this unit."""

    title: str
    scale: float
    low: float
    high: float


#: by the name of the gait's field; the driver plays no smaller stroke and no lower frequency
FIELDS: Mapping[str, GaitField] = {
    "stroke": GaitField("stroke, mm", 1e3, 1.0, 1e3 * limits_of_gaits.MAX_STROKE),
    "frequency": GaitField("frequency, Hz", 1.0, 0.02, limits_of_gaits.MAX_FREQUENCY),
    "margin": GaitField("margin, mm", 1e3, 0.0, 1e3 * limits_of_gaits.MAX_MARGIN),
    "pretension": GaitField("pretension, mm", 1e3, 0.0, 1e3 * limits_of_gaits.MAX_PRETENSION),
    "contraction_share": GaitField(
        "contraction share", 1.0, *limits_of_gaits.CONTRACTION_SHARE_RANGE
    ),
    "ramp_share": GaitField("ramp share", 1.0, *limits_of_gaits.RAMP_SHARE_RANGE),
}


def field_error(shown: Mapping[str, float]) -> str:
    """Return what is wrong with the first inadmissible value (NaN: empty field); empty if all are admissible."""
    for name, (title, _, low, high) in FIELDS.items():
        if not low <= shown[name] <= high:
            return f"{title}: enter a number from {low:g} to {high:g}"
    return ""


def rejection(gait: Gait, limits: Sequence[float]) -> str:
    """Return the reason why a driver with the values ``limits`` of `LIMITS` rejects a gait; empty if there is none."""
    asked = (
        ("stroke plus pretension, mm", 1e3, gait.reach),
        ("frequency, Hz", 1.0, gait.frequency),
        ("speed of the cable, mm/s", 1e3, gait.peak_speed),
    )
    for (title, scale, value), limit in zip(asked, limits, strict=True):
        if value > limit + _ROUNDING:
            return f"{title}: {scale * value:.4g} is more than the driver's limit of {scale * limit:.4g}"
    return ""
