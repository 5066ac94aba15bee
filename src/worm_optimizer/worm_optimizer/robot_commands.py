# SPDX-License-Identifier: Apache-2.0
"""Commands to a robot, their progress and results, and the latest state of robot and twin, as values without ROS."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from worm_model.errors import InputError
from worm_model.gait import Gait, Profile
from worm_model.run import Activity, LengthSource
from worm_model.twin.data.records import Health, StateRecord
from worm_model.twin.scene import PositionSample

MOST_CYCLES = 1000  # largest number of cycles or grooves of a run; the driver limits only cycles


@dataclass(frozen=True)
class GaitCommand:
    """Gait to run until the first of the given ends is reached. An end with the value 0 counts as not given.

    Attributes:
        gait: the gait.
        cycles: number of cycles.
        grooves: number of grooves along the gait's direction.
        distance: distance along the gait's direction, m.
    """

    gait: Gait
    cycles: int = 0
    grooves: int = 0
    distance: float = 0.0

    def __post_init__(self) -> None:
        if not 0 <= self.cycles <= MOST_CYCLES:
            raise InputError(f"cycles: {self.cycles} is not between 0 and {MOST_CYCLES}")
        if not 0 <= self.grooves <= MOST_CYCLES:
            raise InputError(f"grooves: {self.grooves} is not between 0 and {MOST_CYCLES}")
        if not 0.0 <= self.distance < math.inf:
            raise InputError(f"distance: {self.distance} m is not a finite length of at least 0")
        if not (self.cycles or self.grooves or self.distance):
            raise InputError("a run needs an end: cycles, grooves or a distance")

    def __str__(self) -> str:
        gait = self.gait
        parts = [f"stroke {1e3 * gait.stroke:.1f} mm", f"frequency {gait.frequency:.3f} Hz"]
        if not gait.is_sinusoid:
            parts.append(f"pretension {1e3 * gait.pretension:.1f} mm")
            parts.append(f"contraction share {gait.contraction_share:g}, {gait.profile}")
            if gait.profile is Profile.TRAPEZOID:
                parts.append(f"ramp share {gait.ramp_share:g}")
        parts.append("forward" if gait.direction > 0 else "reverse")
        ends = (
            (self.cycles, f"{self.cycles} cycles"),
            (self.grooves, f"{self.grooves} grooves"),
            (self.distance, f"{1e3 * self.distance:g} mm"),
        )
        return ", ".join([*parts, " or ".join(text for given, text in ends if given)])


@dataclass(frozen=True)
class RunProgress:
    """Progress of a run.

    Attributes:
        cycle: number of the present cycle, counted from 1; 0 while the robot rests before the gait.
        elapsed: time since the onset, s; negative before the onset.
        grooves: distance since the onset along the gait's direction, in grooves; NaN without a tracker.
        distance: the same distance, m; NaN without a tracker.
        power: latest valid sample of the source power, W; NaN without one.
    """

    cycle: int
    elapsed: float
    grooves: float
    distance: float
    power: float

    def __str__(self) -> str:
        if self.cycle == 0:
            return "resting"
        texts = [f"cycle {self.cycle}"]
        if math.isfinite(self.distance):
            texts.append(f"{1e3 * self.distance:+.1f} mm, {self.grooves:+.1f} grooves")
        if math.isfinite(self.power):
            texts.append(f"{self.power:.2f} W")
        return ", ".join(texts)


Progress = Callable[[RunProgress], None]


@dataclass(frozen=True)
class RunResult:
    """Result of a run, in SI units. Values without a measurement are NaN. The ``message`` describes the end."""

    gait: Gait
    success: bool
    message: str
    cycles_completed: int = 0
    cycles_averaged: int = 0
    grooves: float = math.nan
    distance: float = math.nan
    speed: float = math.nan
    power: float = math.nan
    cost_of_transport: float = math.nan
    idle_power: float = math.nan


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


@dataclass(frozen=True)
class Snapshot:
    """Latest messages of the robot's topics; None or NaN before the first message.

    Attributes:
        driver: state of the driver.
        twin: state of the twin.
        health: health of the robot according to the twin.
        health_message: cause of the health; empty without one.
        robot: latest sample of the tracker.
        robot_at_twin: sample of the tracker that is nearest to the stamp of ``twin``.
        lengths: body lengths by source, m.
        power: measured power, W.
        twin_age: newest stamp of tracker, power and commanded length minus stamp of ``twin``, s.
        received: time at which the latest message of each topic was received, s (monotonic clock).
    """

    driver: DriverState | None = None
    twin: StateRecord | None = None
    health: Health | None = None
    health_message: str = ""
    robot: PositionSample = field(default_factory=PositionSample)
    robot_at_twin: PositionSample = field(default_factory=PositionSample)
    lengths: Mapping[LengthSource, float] = field(default_factory=dict)
    power: float = math.nan
    twin_age: float = math.nan
    received: Mapping[str, float] = field(default_factory=dict)
