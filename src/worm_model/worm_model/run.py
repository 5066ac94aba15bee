# SPDX-License-Identifier: Apache-2.0
"""One run of the worm as typed arrays: what was commanded, measured and played, whoever recorded it.

Stamps are acquisition stamps in ns since the epoch (int64, shape (n,)), in the order of reception; other quantities
are SI units, float64 of shape (n,) unless said otherwise. A topic that was not recorded has no samples.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from worm_model.gait import Gait, GaitError

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]
Codes = NDArray[np.int64]

RUNNING, STOPPING = 3, 4  # GaitState
POWER_VALID = 0  # Power.VALID


def seconds(stamp: Stamps, origin: int) -> Array:
    """Stamps as s since an origin (ns since the epoch); exact to a ns for months around it."""
    return (stamp - origin).astype(np.float64) * 1e-9


def _stamps() -> Stamps:
    return np.empty(0, np.int64)


def _array() -> Array:
    return np.empty(0)


@dataclass(frozen=True)
class LengthSamples:
    """Body lengths from one source: `length` m, and `length_change` m, negative in contraction."""

    stamp: Stamps = field(default_factory=_stamps)
    length: Array = field(default_factory=_array)
    length_change: Array = field(default_factory=_array)


@dataclass(frozen=True)
class TrackerSamples:
    """Positions along the pipe, x1 of the rear and x2 of the front module, m; NaN while a marker is occluded."""

    stamp: Stamps = field(default_factory=_stamps)
    rear_position: Array = field(default_factory=_array)
    front_position: Array = field(default_factory=_array)


@dataclass(frozen=True)
class PowerSamples:
    """Source-side electrical power W, bus voltage V and current A; NaN where `status` is not POWER_VALID."""

    stamp: Stamps = field(default_factory=_stamps)
    status: Codes = field(default_factory=_stamps)
    bus_voltage: Array = field(default_factory=_array)
    current: Array = field(default_factory=_array)
    power: Array = field(default_factory=_array)

    @property
    def valid_power(self) -> Array:
        """Power in W, NaN unless the sensor calls it valid."""
        return np.where(self.status == POWER_VALID, self.power, np.nan)


@dataclass(frozen=True)
class GaitStates:
    """What the driver did: `state` as GaitState has it, the gait, and its `onset` (ns since the epoch, 0: unknown).

    `run` is the run's number, 0 where an old recording does not tell.
    """

    stamp: Stamps = field(default_factory=_stamps)
    state: Codes = field(default_factory=_stamps)
    stroke: Array = field(default_factory=_array)
    frequency: Array = field(default_factory=_array)
    direction: Codes = field(default_factory=_stamps)
    margin: Array = field(default_factory=_array)
    onset: Stamps = field(default_factory=_stamps)
    cycle: Codes = field(default_factory=_stamps)
    cycles: Codes = field(default_factory=_stamps)
    run: Codes = field(default_factory=_stamps)

    def __post_init__(self) -> None:
        if len(self.run) != len(self.stamp):
            object.__setattr__(self, "run", np.zeros(len(self.stamp), np.int64))

    @property
    def played(self) -> NDArray[np.bool_]:
        """In which states a gait runs whose onset is known, shape (n,)."""
        return (self.state == RUNNING) & (self.onset > 0)


@dataclass(frozen=True)
class JointSamples:
    """Servo states: `position` rad, `velocity` rad/s, `effort` A or ratio, each of shape (n, len(names)) or (n, 0)."""

    names: tuple[str, ...] = ()
    stamp: Stamps = field(default_factory=_stamps)
    position: Array = field(default_factory=_array)
    velocity: Array = field(default_factory=_array)
    effort: Array = field(default_factory=_array)


@dataclass(frozen=True)
class Run:
    """A run: `origin` is its least stamp (ns since the epoch), 0 if it has no samples at all."""

    origin: int = 0
    commanded: LengthSamples = field(default_factory=LengthSamples)
    cable: LengthSamples = field(default_factory=LengthSamples)
    estimated: LengthSamples = field(default_factory=LengthSamples)
    measured: LengthSamples = field(default_factory=LengthSamples)
    tracker: TrackerSamples = field(default_factory=TrackerSamples)
    power: PowerSamples = field(default_factory=PowerSamples)
    gait_state: GaitStates = field(default_factory=GaitStates)
    joint_states: JointSamples = field(default_factory=JointSamples)


@dataclass(frozen=True)
class PlayedRun:
    """A run in a recording: ``onset`` (ns), the gait, ``cycles`` asked for (0: unknown), ``end`` (ns).

    ``end`` is that of the last cycle asked for, or of the last sample of any length or of the tracker.
    """

    number: int
    onset: int
    end: int
    gait: Gait
    cycles: int

    @property
    def period_ns(self) -> float:
        """Duration of a cycle."""
        return 1e9 * self.gait.period


SAME_ONSET_NS = 100_000_000  # the driver states the onset anew with each cycle, through two clocks


def is_same_run(run: int, onset: int, other_run: int, other_onset: int) -> bool:
    """Whether two gait states speak of one run, by its number and its onset (ns).

    Old recordings have no numbers (0), and a driver that starts anew counts anew: only the onset tells these.
    """
    return run == other_run and abs(onset - other_onset) <= SAME_ONSET_NS


def played_runs(run: Run) -> list[PlayedRun]:
    """The runs of a recording in their order; a gait that is not admissible is none."""
    states = run.gait_state
    lasts = [s.stamp[-1] for s in (run.commanded, run.measured, run.tracker) if len(s.stamp)]
    recorded_until = int(max(lasts, default=run.origin))
    found: list[PlayedRun] = []
    for row in np.flatnonzero(states.played).tolist():
        number, onset = int(states.run[row]), int(states.onset[row])
        if found and is_same_run(number, onset, found[-1].number, found[-1].onset):
            continue
        try:
            gait = Gait(
                float(states.stroke[row]),
                float(states.frequency[row]),
                int(states.direction[row]),
                float(states.margin[row]),
            )
        except GaitError:
            continue
        cycles = int(states.cycles[row]) if len(states.cycles) else 0
        asked = onset + round(cycles * 1e9 * gait.period) if cycles else recorded_until
        over = np.flatnonzero((states.stamp > onset) & ~np.isin(states.state, (RUNNING, STOPPING)))
        stopped = int(states.stamp[over[0]]) if len(over) else recorded_until
        ends = min(asked, recorded_until, max(stopped, onset))
        if (
            stopped + SAME_ONSET_NS >= asked
        ):  # the driver tells of the end a little before or after it
            ends = min(asked, recorded_until)
        found.append(PlayedRun(number, onset, ends, gait, cycles))
    return found
