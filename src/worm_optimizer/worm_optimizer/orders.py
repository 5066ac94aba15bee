# SPDX-License-Identifier: Apache-2.0
"""What a person asks of a robot and what comes back, as values that know no ROS."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from worm_model.errors import InputError
from worm_model.gait import Gait, Profile

MOST_CYCLES = 1000  # of one run, as the driver's limits say


@dataclass(frozen=True)
class Order:
    """A gait to run until the first of the ends that are asked for; 0: does not matter.

    ``cycles`` and ``grooves`` are counts, ``distance`` is in m along the gait's direction. Raises `InputError`
    on values that no run can have, and without any end.
    """

    gait: Gait
    cycles: int = 0
    grooves: int = 0
    distance: float = 0.0

    def __post_init__(self) -> None:
        if not 0 <= self.cycles <= MOST_CYCLES:
            raise InputError(f"cycles: {self.cycles} is not between 1 and {MOST_CYCLES}")
        if not 0 <= self.grooves <= MOST_CYCLES:
            raise InputError(f"grooves: {self.grooves} is not between 1 and {MOST_CYCLES}")
        if not 0.0 <= self.distance < math.inf:
            raise InputError(f"distance: {self.distance} m is no positive length")
        if not (self.cycles or self.grooves or self.distance):
            raise InputError("a run needs an end: cycles, grooves or a distance")

    def __str__(self) -> str:
        gait = self.gait
        ends = (
            (self.cycles, f"{self.cycles} cycles"),
            (self.grooves, f"{self.grooves} grooves"),
            (self.distance, f"{1e3 * self.distance:g} mm"),
        )
        trapezoid = gait.profile is Profile.TRAPEZOID
        parts = (
            (True, f"stroke {1e3 * gait.stroke:.1f} mm"),
            (True, f"frequency {gait.frequency:.3f} Hz"),
            (gait.pretension, f"pretension {1e3 * gait.pretension:.1f} mm"),
            (gait.contraction_share != 0.5, f"contraction share {gait.contraction_share:g}"),
            (trapezoid, f"trapezoid with ramp share {gait.ramp_share:g}"),
            (True, "forward" if gait.direction > 0 else "reverse"),
            (True, " or ".join(words for wanted, words in ends if wanted)),
        )
        return ", ".join(words for shown, words in parts if shown)


@dataclass(frozen=True)
class RunProgress:
    """Of a run that goes on: ``cycle`` counts those begun, ``elapsed`` (s) is negative while resting.

    ``grooves``, ``distance`` (m) and ``power`` (W) are NaN where nothing measures them.
    """

    cycle: int
    elapsed: float
    grooves: float
    distance: float
    power: float

    def __str__(self) -> str:
        if self.cycle == 0:
            return "resting"
        words = [f"cycle {self.cycle}"]
        if math.isfinite(self.distance):
            words.append(f"{1e3 * self.distance:+.1f} mm, {self.grooves:+.1f} grooves")
        if math.isfinite(self.power):
            words.append(f"{self.power:.2f} W")
        return ", ".join(words)


Progress = Callable[[RunProgress], None]


@dataclass(frozen=True)
class ScanOrder:
    """A margin scan to ask of the optimizer: margins in m, ``highest`` and ``step`` 0 for its own."""

    direction: int
    lowest: float = 0.0
    highest: float = 0.0
    step: float = 0.0


@dataclass(frozen=True)
class FrontOrder:
    """An optimisation to ask of the optimizer: ``margin`` in m, NaN: at the cliff; ``probability`` 0: its own."""

    direction: int
    robustness: str = "margin"
    margin: float = math.nan
    probability: float = 0.0


@dataclass(frozen=True)
class SearchResult:
    """What came of a search, or why nothing did, in words.

    Of a scan also the ``margins`` in m with their lowest ``costs`` of transport, and the last margin before the
    ``cliff`` in m, NaN without one.
    """

    success: bool
    message: str
    margins: tuple[float, ...] = ()
    costs: tuple[float, ...] = ()
    cliff: float = math.nan


@dataclass(frozen=True)
class RunResult:
    """What was measured of a run, SI units, NaN where it could not be; the ``message`` says what happened and why."""

    gait: Gait
    success: bool
    message: str
    cycles_completed: int
    cycles_averaged: int
    grooves: float
    distance: float
    speed: float
    power: float
    cost_of_transport: float
    idle_power: float


@dataclass(frozen=True)
class RobotState:
    """What is heard of a robot now.

    ``lifecycle`` is the driver's primary state, ``state`` GaitState's name; ``power`` (W) and ``rear_position`` (m)
    are NaN, ``health`` is empty and ``initial_length`` 0 where nobody tells them.
    """

    lifecycle: str
    state: str
    homed: bool
    emergency_stop: bool
    cycle: int
    cycles: int
    stroke: float
    frequency: float
    direction: int
    message: str
    power: float = math.nan
    rear_position: float = math.nan
    health: str = ""
    initial_length: float = 0.0
