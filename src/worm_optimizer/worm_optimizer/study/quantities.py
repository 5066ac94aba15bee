# SPDX-License-Identifier: Apache-2.0
"""Quantities that a study may vary or fix: keys of a parameter file, conditions in the pipe, and others (`_OTHERS`)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from worm_msgs.conditions import CONDITION_ROWS
from worm_msgs.gait import (
    CONTRACTION_SHARE_RANGE,
    MAX_FREQUENCY,
    MAX_MARGIN,
    MAX_PRETENSION,
    MAX_STROKE,
    RAMP_SHARE_RANGE,
)
from worm_msgs.robot_parameters import ROWS

_SMALL, _LARGE = 1e-6, 1e6  # bounds of positive quantities, in their units


@dataclass(frozen=True)
class Quantity:
    """Quantity: ``unit``, description, and admissible range. A value outside the range is probably in another unit."""

    unit: str
    long_name: str
    low: float
    high: float


_OTHERS: Mapping[str, Quantity] = {
    "margin_m": Quantity("m", "robustness margin", 0.0, MAX_MARGIN),
    "direction": Quantity("1", "direction: 1 forward, -1 reverse", -1.0, 1.0),
    "groove_phase_m": Quantity("m", "groove phase", -0.1, 0.1),
    "spool_radius_m": Quantity("m", "spool radius of the cable servos", 1e-3, 1.0),
    "min_stroke_m": Quantity("m", "shortest stroke", _SMALL, MAX_STROKE),
    "max_stroke_m": Quantity("m", "longest stroke", _SMALL, MAX_STROKE),
    "min_frequency_Hz": Quantity("Hz", "lowest frequency", _SMALL, MAX_FREQUENCY),
    "max_frequency_Hz": Quantity("Hz", "highest frequency", _SMALL, MAX_FREQUENCY),
    "max_cable_speed_m_per_s": Quantity("m/s", "highest cable speed", _SMALL, _LARGE),
    "max_cable_force_N": Quantity("N", "highest cable force", _SMALL, _LARGE),
    "max_power_W": Quantity("W", "highest source power", _SMALL, _LARGE),
    "stall_force_N": Quantity("N", "cable force at which the motors stall", _SMALL, _LARGE),
    "no_load_speed_m_s": Quantity("m/s", "cable speed of the motors without load", _SMALL, _LARGE),
    "max_push_force_N": Quantity("N", "highest pushing force in the model's cable", _SMALL, _LARGE),
    "holding_power_W_per_N": Quantity("W/N", "power for each N of the mean pull", 0.0, _LARGE),
    "min_pretension_m": Quantity("m", "least pretension", 0.0, MAX_PRETENSION),
    "max_pretension_m": Quantity("m", "greatest pretension", 0.0, MAX_PRETENSION),
    "min_contraction_share": Quantity("1", "least contraction share", *CONTRACTION_SHARE_RANGE),
    "max_contraction_share": Quantity("1", "greatest contraction share", *CONTRACTION_SHARE_RANGE),
    "min_ramp_share": Quantity("1", "least ramp share", *RAMP_SHARE_RANGE),
    "max_ramp_share": Quantity("1", "greatest ramp share", *RAMP_SHARE_RANGE),
    "at_power_W": Quantity("W", "power of the gait max_speed_at_power", _SMALL, _LARGE),
    "at_speed_m_s": Quantity("m/s", "speed of the gait min_power_at_speed", _SMALL, _LARGE),
    "reference_power_W": Quantity("W", "power up to which hypervolumes count", _SMALL, _LARGE),
}
LIMITS = (  # in the order of the fields of ActuatorLimits
    *("max_cable_speed_m_per_s", "max_cable_force_N", "max_power_W"),
    *("stall_force_N", "no_load_speed_m_s", "max_push_force_N"),
)
SHAPE_BOUNDS = (  # lower and upper end of each field of ShapeBounds, in the order of the fields
    ("min_pretension_m", "max_pretension_m"),
    ("min_contraction_share", "max_contraction_share"),
    ("min_ramp_share", "max_ramp_share"),
)
# Units in the notation of the CF conventions
_CF_UNITS = {"°": "degree", "deg": "degree", "m²": "m2", "N·s/m": "N s/m"}
QUANTITIES: Mapping[str, Quantity] = {
    **{
        key: Quantity(
            _CF_UNITS.get(row["unit"], row["unit"]),
            f"{key.replace('_', ' ')} ({row['paper']})",
            row["low"],
            row["high"],
        )
        for key, row in ROWS.items()
    },
    **{
        key: Quantity(
            _CF_UNITS.get(row["unit"], row["unit"]), row["meaning"], row["low"], row["high"]
        )
        for key, row in CONDITION_ROWS.items()
    },
    **_OTHERS,
}
