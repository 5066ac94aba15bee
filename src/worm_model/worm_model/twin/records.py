# SPDX-License-Identifier: Apache-2.0
"""What comes out of the twin: records and their rows, stamps in integer nanoseconds.

Field by field they are the messages TwinState, TwinResiduals and TwinEvent of worm_msgs; the node and the offline
replay convert them, the core knows no ROS.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, get_type_hints

import numpy as np

NANOSECONDS = 1_000_000_000


class LengthSource(enum.IntEnum):
    """As in BodyLength."""

    COMMANDED = 0
    CABLE = 1
    ESTIMATED = 2
    MEASURED = 3


class Activity(enum.IntEnum):
    """What the driver does, as in GaitState."""

    INACTIVE = 0
    IDLE = 1
    RESTING = 2
    RUNNING = 3
    STOPPING = 4
    FAULT = 5

    @classmethod
    def _missing_(cls, value: object) -> Activity:  # noqa: ARG003
        """A state of a driver newer than this twin: nothing that it could follow."""
        return cls.INACTIVE


class Health(enum.IntEnum):
    """As in TwinResiduals."""

    UNKNOWN = 0
    HEALTHY = 1
    SUSPECT = 2
    FAULTY = 3


@dataclass(frozen=True)
class StateRecord:
    """The message TwinState: positions in the tracker's frame, SI."""

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


def row_type(record: type, more: Mapping[str, type] | None = None) -> np.dtype[np.void]:
    """The numeric fields of a kind of record as a structured type: int64 where one is a whole number, else float64."""
    fields = {name: kind for name, kind in get_type_hints(record).items() if kind is not str}
    fields |= more or {}
    return np.dtype(
        [(n, np.int64 if issubclass(k, int) else np.float64) for n, k in fields.items()]
    )


@dataclass(frozen=True)
class ResidualRecord:
    """The message TwinResiduals: measured minus predicted, NaN where there is no measurement."""

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
    """Of an event."""

    INFO = 0
    WARNING = 1
    ERROR = 2


@dataclass(frozen=True)
class Event:
    """The message TwinEvent: something that the operator should read.

    ``code`` is one of those of TwinEvent, or empty for what is only worth a word; ``cycle`` and ``run`` are 0 where
    they do not apply, ``probability`` is NaN where none was computed.
    """

    stamp_ns: int
    severity: Severity
    text: str
    code: str = ""
    cycle: int = 0
    run: int = 0
    probability: float = math.nan


STATE_ROW = row_type(StateRecord)
#: what of a residual is published beside its stamp: what its health came from, its message has in words
RESIDUAL_FIELDS = (row_type(ResidualRecord).names or ())[1:]
#: a residual with its channels' sizes (in usual ones, NaN without a say) and levels, and the number of the warning
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
    """What is wrong according to a row of RESIDUAL_ROW; ``warnings`` are the texts that it refers to by number."""
    warning = [warnings[row["warning"]]] if row["warning"] in warnings else []
    warning += [
        f"{text} ({row[f'{name}_size']:.1f} times the usual residual)"
        for name, text in COMPLAINTS.items()
        if row[f"{name}_level"] >= Health.SUSPECT
    ]
    return "; ".join(warning)
