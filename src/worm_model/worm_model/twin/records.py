# SPDX-License-Identifier: Apache-2.0
"""What goes into the twin and what comes out of it: frozen records, stamps in integer nanoseconds.

Field by field the outputs are the messages TwinState, TwinResiduals and BodyLength of worm_msgs; the
node and the offline replay convert them, the core knows no ROS.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass

from worm_model.gait import Gait

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
class CommandedLength:
    """``length_change``: u_cmd in m, contraction negative."""

    stamp_ns: int
    length_change: float


@dataclass(frozen=True)
class MeasuredLength:
    """``length``: realised body length L in m, as an instrument sees it."""

    stamp_ns: int
    length: float


@dataclass(frozen=True)
class TrackerSample:
    """Module positions in m in the tracker's frame; NaN where a marker is hidden."""

    stamp_ns: int
    rear_position: float
    front_position: float


@dataclass(frozen=True)
class PowerSample:
    """``power`` in W; NaN where the sensor gave none."""

    stamp_ns: int
    power: float


@dataclass(frozen=True)
class GaitSample:
    """What the driver does from a stamp on; ``onset_ns`` is 0 before it is known, ``gait`` None when there is none."""

    stamp_ns: int
    activity: Activity
    gait: Gait | None = None
    onset_ns: int = 0


Sample = CommandedLength | MeasuredLength | TrackerSample | PowerSample | GaitSample


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


@dataclass(frozen=True)
class LengthRecord:
    """The message BodyLength with source ESTIMATED, m."""

    stamp_ns: int
    length: float
    length_change: float


class Severity(enum.IntEnum):
    """Of a notice."""

    INFO = 0
    WARNING = 1
    ERROR = 2


@dataclass(frozen=True)
class Notice:
    """Something that the operator should read."""

    stamp_ns: int
    severity: Severity
    text: str


@dataclass(frozen=True)
class Output:
    """What one step of the twin yields, each in stamp order."""

    states: tuple[StateRecord, ...] = ()
    residuals: tuple[ResidualRecord, ...] = ()
    lengths: tuple[LengthRecord, ...] = ()
    notices: tuple[Notice, ...] = ()
