# SPDX-License-Identifier: Apache-2.0
"""The latest state of a robot and its twin, as values that do not depend on ROS."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from worm_model.run import Activity, LengthSource
from worm_model.twin.data.records import ResidualRecord, StateRecord
from worm_model.twin.scene import PositionSample


@dataclass(frozen=True)
class DriverState:
    """Content of the driver's latest GaitState.

    Attributes:
        state: activity of the driver.
        homed: True if homing has defined the zero of the cable length.
        emergency_stop: True if the emergency stop is on.
        run: number of the latest run; 0 before the first run.
        cycle: number of the present cycle of the run; 0 before the first cycle.
        cycles: number of requested cycles. In a run by grooves or distance, an upper bound until the last cycle is
            known.
        stroke: stroke of the gait, m; 0 without a gait.
        frequency: frequency of the gait, Hz.
        direction: direction of the gait, FORWARD or REVERSE.
        holding: True from a stop until the operator starts a run or deactivates the driver.
        message: reason of the state.
        stamp_ns: stamp of the message.
        onset_ns: stamp of the gait's onset; 0 without one.
    """

    state: Activity
    homed: bool
    emergency_stop: bool
    run: int
    cycle: int
    cycles: int
    stroke: float
    frequency: float
    direction: int
    message: str
    holding: bool = False
    stamp_ns: int = 0
    onset_ns: int = 0


@dataclass(frozen=True)
class Snapshot:
    """Latest messages of the robot's topics; None or NaN before the first message.

    Attributes:
        driver: state of the driver.
        twin: state of the twin.
        residuals: residuals of the twin; NaN where no sensor measures them.
        robot: latest sample of the tracker.
        robot_at_twin: sample of the tracker that is nearest to the stamp of ``twin``.
        lengths: body lengths by source, m.
        power: measured power, W.
        twin_age: newest stamp of tracker, power and commanded length minus stamp of ``twin``, s.
        received: time at which the latest message of each topic was received, s (monotonic clock).
    """

    driver: DriverState | None = None
    twin: StateRecord | None = None
    residuals: ResidualRecord | None = None
    robot: PositionSample = field(default_factory=PositionSample)
    robot_at_twin: PositionSample = field(default_factory=PositionSample)
    lengths: Mapping[LengthSource, float] = field(default_factory=dict)
    power: float = math.nan
    twin_age: float = math.nan
    received: Mapping[str, float] = field(default_factory=dict)
