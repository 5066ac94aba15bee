# SPDX-License-Identifier: Apache-2.0
"""Records that the twin outputs, and the structured types of their rows. Stamps are integer nanoseconds.

The fields are those of the messages TwinState, TwinResiduals and TwinEvent of worm_msgs, which describe them. The node
converts rows and events to messages, so that the twin does not depend on ROS.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, get_type_hints

import numpy as np

from worm_model.run import LengthSource

NANOSECONDS = 1_000_000_000
STALE_S = 1.0  # time without a message after which its source counts as silent


class Health(enum.IntEnum):
    """Health of the robot, with the values of the message TwinResiduals."""

    UNKNOWN = 0
    HEALTHY = 1
    SUSPECT = 2
    FAULTY = 3


@dataclass(frozen=True)
class StateRecord:
    """Content of the message TwinState; positions in the tracker's frame, SI units."""

    stamp_ns: int
    length_source: LengthSource
    initial_length: float
    groove_phase: float
    length: float
    length_rate: float
    rear_position: float
    front_position: float
    rear_velocity: float
    front_velocity: float
    rear_anchor: float
    front_anchor: float
    rear_groove: int
    front_groove: int
    cable_force: float
    rear_fin_force: float
    front_fin_force: float
    power: float
    energy: float
    margin_grooves: int = 0
    rear_margin: float = math.nan
    front_margin: float = math.nan
    rear_margin_scatter: float = math.nan
    front_margin_scatter: float = math.nan
    last_rear_margin: float = math.nan
    last_front_margin: float = math.nan
    keeps_probability: float = math.nan


def row_type(record: type, more: Mapping[str, type] | None = None) -> np.dtype[np.void]:
    """Return the numeric fields of a record class as a structured type.

    Integer fields become int64, strings are left out, and all other fields become float64. ``more`` contains additional
    fields.
    """
    fields = {name: kind for name, kind in get_type_hints(record).items() if kind is not str}
    fields |= more or {}
    return np.dtype(
        [(n, np.int64 if issubclass(k, int) else np.float64) for n, k in fields.items()]
    )


@dataclass(frozen=True)
class ResidualRecord:
    """Content of the message TwinResiduals: measured minus predicted values, NaN without a measurement."""

    stamp_ns: int
    rear_position: float
    rear_position_scale: float
    length: float
    length_scale: float
    power: float
    power_scale: float
    energy: float
    health: Health
    message: str


class Severity(enum.IntEnum):
    """Severity of an event."""

    INFO = 0
    WARNING = 1
    ERROR = 2


@dataclass(frozen=True)
class Event:
    """Content of the message TwinEvent: a notice for the operator.

    ``code`` is one of the codes of TwinEvent, or empty for plain information. ``cycle`` and ``run`` are 0 if the event
    belongs to none. ``probability`` is NaN if it was not computed.
    """

    stamp_ns: int
    severity: Severity
    text: str
    code: str = ""
    cycle: int = 0
    run: int = 0
    probability: float = math.nan


STATE_ROW = row_type(StateRecord)
#: fields of TwinResiduals except the stamp and the message
RESIDUAL_FIELDS = (row_type(ResidualRecord).names or ())[1:]
#: Row of a residual. ``…_size`` is the root mean square of a channel's residuals divided by their usual size (NaN
#: without data), ``…_level`` is the Health of the channel, and ``warning`` is the number of the warning that affects
#: the health, 0 if none.
RESIDUAL_ROW = row_type(
    ResidualRecord,
    {
        "position_size": float,
        "length_size": float,
        "power_size": float,
        "position_level": int,
        "length_level": int,
        "power_level": int,
        "warning": int,
    },
)

COMPLAINTS = {
    "position": "the robot is not where the twin expects it",
    "length": "the body does not follow the command as the actuation model expects",
    "power": "the power is not what the motion should cost",
}


def residual_message(row: Any, warnings: Mapping[int, str]) -> str:
    """Return the description of a row of RESIDUAL_ROW; empty while the robot is healthy or the health is unknown.

    ``warnings`` contains the texts of the warnings by number.
    """
    if row["health"] <= Health.HEALTHY:
        return ""
    warning = [warnings[row["warning"]]] if row["warning"] in warnings else []
    warning += [
        f"{text} ({row[f'{name}_size']:.1f} times the usual residual)"
        for name, text in COMPLAINTS.items()
        if row[f"{name}_level"] >= Health.SUSPECT
    ]
    return "; ".join(warning)
