# SPDX-License-Identifier: Apache-2.0
"""Recording of the robot as typed arrays: commands, measurements and states of the driver.

Stamps are acquisition stamps in ns since the epoch (int64, shape (n,)), in the order of reception. Other quantities
are in SI units, float64 of shape (n,) unless stated otherwise. A topic that was not recorded has no samples.
"""

from __future__ import annotations

import enum
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, fields, make_dataclass
from datetime import UTC, datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from worm_model.arrays import Array, Stamps
from worm_msgs.gait import GAIT_DEFAULTS, GAIT_TYPES, GAIT_UNITS, Gait, gait_of

Codes = NDArray[np.int64]

# Values of the messages for code without ROS; a test compares them with worm_msgs.
POWER_VALID = 0
POWER_STATUS_NAMES = ("valid", "overflow", "not ready", "bus error", "sensor reset")

# ns. The driver converts a run's onset from its monotonic clock to system time for each message, so the published
# onsets of one run differ slightly. They differ by less than this; onsets of different runs differ by more.
SAME_ONSET_NS = 100_000_000


class LengthSource(enum.IntEnum):
    """Source of a body length, with the values of the message BodyLength."""

    COMMANDED = 0
    CABLE = 1
    ESTIMATED = 2
    MEASURED = 3


class Activity(enum.IntEnum):
    """Activity of the driver, with the values of the message GaitState."""

    INACTIVE = 0
    IDLE = 1
    RESTING = 2
    RUNNING = 3
    STOPPING = 4
    FAULT = 5

    @classmethod
    def _missing_(cls, value: object) -> Activity:  # noqa: ARG003
        """Return INACTIVE for an unknown state, which only a newer driver has."""
        return cls.INACTIVE


PLAYING = (Activity.RUNNING, Activity.STOPPING)  # activities during a gait


def state_name(state: int) -> str:
    """Return the name of a value of GaitState.state."""
    return Activity(state).name.lower() if state in list(Activity) else f"state {state}"


def power_status_name(status: int) -> str:
    """Return the name of a value of Power.status."""
    known = 0 <= status < len(POWER_STATUS_NAMES)
    return POWER_STATUS_NAMES[status] if known else f"status {status}"


def is_another_run(before: tuple[Any, Any, Any], after: tuple[Any, Any, Any]) -> Any:
    """Return True where a gait state belongs to another run than the previous state.

    ``before`` and ``after`` are (number of the run, number of the cycle, onset in ns), each a number or arrays of one
    shape. Runs differ if the driver's run numbers differ, or if the cycle number decreases, because a restarted driver
    counts from 1. In a recording without run numbers, runs differ if their onsets differ by more than `SAME_ONSET_NS`.
    """
    (run, cycle, onset), (next_run, next_cycle, next_onset) = before, after
    restarted, moved = next_cycle < cycle, abs(next_onset - onset) > SAME_ONSET_NS
    return (next_run != run) | np.where(next_run > 0, restarted, moved)


def nanoseconds(stamp: Any) -> int:
    """Return the nanoseconds of a builtin_interfaces/Time."""
    total: int = stamp.sec * 10**9 + stamp.nanosec
    return total


def seconds(stamp: Stamps, origin: int) -> Array:
    """Return stamps as s since an origin (ns since the epoch), exact to a ns within months of the origin."""
    return (stamp - origin).astype(np.float64) * 1e-9


def utc_of(stamp: int) -> str:
    """Return a stamp (ns since the epoch) as date and time in UTC to the second, ISO 8601."""
    return datetime.fromtimestamp(stamp * 1e-9, UTC).isoformat(timespec="seconds")


def concatenated(kind: type[Any], parts: Sequence[Any]) -> Any:
    """Return the samples of several parts, all of the class ``kind`` of this module, as one object of this class.

    Parts without samples are skipped.
    """
    parts = [part for part in parts if len(part.stamp)]
    columns: dict[str, Any] = {}
    for name in (each.name for each in fields(kind)) if parts else ():
        values = [getattr(part, name) for part in parts]
        if isinstance(values[0], np.ndarray):
            columns[name] = np.concatenate(values)
        elif any(value != values[0] for value in values):
            raise ValueError(f"{name} changes")
        else:
            columns[name] = values[0]
    return kind(**columns)


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
    """Positions of the rear module (x1) and the front module (x2) along the pipe, m; NaN while a marker is occluded."""

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
        """Power in W, NaN where its status is not valid."""
        return np.where(self.status == POWER_VALID, self.power, np.nan)


#: the fields of a gait, each as an array (n,)
_GaitColumns: Any = make_dataclass(
    "_GaitColumns",
    [
        (name, Any, field(default_factory=_stamps if issubclass(GAIT_TYPES[name], int) else _array))
        for name in GAIT_UNITS
    ],
    frozen=True,
)


@dataclass(frozen=True, kw_only=True)
class GaitStates(_GaitColumns):
    """States of the driver. The fields of `Gait` are arrays with the same names.

    A field that a recording lacks has the default of `Gait`, or 0 if it is `cycle`, `cycles` or `run`.

    Attributes:
        state: state of the driver, a value of GaitState.state.
        onset: start of the first cycle, ns since the epoch; 0: unknown.
        cycle: number of the present cycle, from 1.
        cycles: requested number of cycles.
        run: number that the driver gave the run.
    """

    stamp: Stamps = field(default_factory=_stamps)
    state: Codes = field(default_factory=_stamps)
    onset: Stamps = field(default_factory=_stamps)
    cycle: Codes = field(default_factory=_stamps)
    cycles: Codes = field(default_factory=_stamps)
    run: Codes = field(default_factory=_stamps)

    def __post_init__(self) -> None:
        unknown = dict.fromkeys(("cycle", "cycles", "run"), 0)  # where a recording lacks them
        for name, default in {**GAIT_DEFAULTS, **unknown}.items():
            if getattr(self, name).size != self.stamp.size:
                kind = getattr(self, name).dtype
                object.__setattr__(self, name, np.full(self.stamp.size, default, kind))

    @classmethod
    def of(cls, gait: Gait, stamp: Stamps, **others: Any) -> GaitStates:
        """Return states of one gait at stamps (n,) in ns; ``others`` are the other fields."""
        values = {name: np.full(stamp.size, value) for name, value in asdict(gait).items()}
        return cls(stamp=stamp, **values, **others)

    def gait(self, row: int) -> Gait:
        """Return the gait of a row; raises `GaitError` if it is not admissible."""
        return gait_of({name: getattr(self, name)[row] for name in GAIT_UNITS})

    @property
    def played(self) -> NDArray[np.bool_]:
        """True for states in which a gait with a known onset runs, shape (n,)."""
        return (self.state == Activity.RUNNING) & (self.onset > 0)

    @property
    def mixed(self) -> bool:
        """True if a run continues after another one has begun, as with several drivers or in merged recordings."""
        onset = self.onset[self._played_rows]
        first = np.append(True, np.abs(np.diff(onset)) > SAME_ONSET_NS)[: onset.size]
        return bool((np.diff(np.sort(onset[first])) <= SAME_ONSET_NS).any())

    @property
    def _played_rows(self) -> NDArray[np.int64]:
        """Rows of `played` in the order of their stamps."""
        rows = np.flatnonzero(self.played)
        return rows[np.argsort(self.stamp[rows], kind="stable")]

    def rows_of_runs(self) -> list[NDArray[np.int64]]:
        """Return the rows of `played` for each run, in the order of their stamps; see `is_another_run`."""
        rows = self._played_rows
        if not rows.size:
            return []
        over = np.sort(self.stamp[~np.isin(self.state, PLAYING)])
        before, after = (
            (self.run[part], self.cycle[part], self.onset[part]) for part in (rows[:-1], rows[1:])
        )
        # A restarted driver counts from 1, so two successive runs may have the same number. They are different runs if
        # the driver was in another state between them, and the onset changed.
        ended = np.searchsorted(over, self.stamp[rows[1:]]) > np.searchsorted(
            over, self.stamp[rows[:-1]]
        )
        moved = np.abs(after[2] - before[2]) > SAME_ONSET_NS
        another = is_another_run(before, after) | (ended & moved)
        return np.split(rows, np.flatnonzero(another) + 1)


@dataclass(frozen=True)
class JointSamples:
    """Servo states: `position` rad, `velocity` rad/s, `effort` N*m, each of shape (n, len(names)) or (n, 0)."""

    names: tuple[str, ...] = ()
    stamp: Stamps = field(default_factory=_stamps)
    position: Array = field(default_factory=_array)
    velocity: Array = field(default_factory=_array)
    effort: Array = field(default_factory=_array)


@dataclass(frozen=True)
class MemorySamples:
    """Memories of the live twin at rest; `content` is text, see `worm_model.twin.stored_memory`."""

    stamp: Stamps = field(default_factory=_stamps)
    content: NDArray[np.object_] = field(default_factory=lambda: np.empty(0, object))


@dataclass(frozen=True)
class Run:
    """Recording of one or several gaits; `origin` is its smallest stamp (ns since the epoch), 0 without samples."""

    origin: int = 0
    commanded: LengthSamples = field(default_factory=LengthSamples)
    cable: LengthSamples = field(default_factory=LengthSamples)
    estimated: LengthSamples = field(default_factory=LengthSamples)
    measured: LengthSamples = field(default_factory=LengthSamples)
    tracker: TrackerSamples = field(default_factory=TrackerSamples)
    power: PowerSamples = field(default_factory=PowerSamples)
    gait_state: GaitStates = field(default_factory=GaitStates)
    joint_states: JointSamples = field(default_factory=JointSamples)
    memory: MemorySamples = field(default_factory=MemorySamples)
