# SPDX-License-Identifier: Apache-2.0
"""Structured rows of the samples that the twin reads, from messages or from a recording."""

from __future__ import annotations

import enum
from contextlib import suppress
from dataclasses import dataclass
from string import ascii_lowercase
from typing import Any

import numpy as np
from numpy.typing import NDArray

from worm_model.run import Activity, Run
from worm_msgs.gait import GAIT_UNITS, Gait, GaitError, gait_of

SampleRows = NDArray[np.void]


class SampleKind(enum.IntEnum):
    """Kind of a sample; samples with equal stamps are processed in this order. GAIT is a driver state."""

    GAIT = 0
    COMMAND = 1
    LENGTH = 2
    POSITION = 3
    POWER = 4


#: names of the values of a sample; a driver state has the most values, the fields of its gait
VALUES = tuple(ascii_lowercase[: len(GAIT_UNITS)])
#: name of the value that contains a field of the gait, by field
GAIT_VALUES = dict(zip(GAIT_UNITS, VALUES, strict=True))

#: A sample takes effect at its ``stamp`` (ns); ``sent`` (ns) is the stamp of its message. The values ``a``, ``b``, …
#: depend on the kind. COMMAND: u_cmd (m). LENGTH: L (m). POSITION: x1, x2 (m). POWER: power (W). GAIT: the gait's
#: fields. Only driver states (GAIT) have ``onset`` (ns), ``state``, ``run`` and ``cycle``. In the row of a LENGTH, the
#: estimator stores in ``c`` the ΔL (m) that it expects from the command.
SAMPLE = np.dtype(
    [
        *((name, np.int64) for name in ("stamp", "kind", "onset", "state", "run", "cycle", "sent")),
        *((name, np.float64) for name in VALUES),
    ]
)
#: no samples
NO_SAMPLES: SampleRows = np.zeros(0, SAMPLE)


def sample_rows(kind: SampleKind, stamp: NDArray[np.int64], *values: NDArray[Any]) -> SampleRows:
    """Return rows of one kind from stamps (n,) in ns and their values, each (n,)."""
    rows = np.zeros(len(stamp), SAMPLE)
    rows["stamp"], rows["kind"], rows["sent"] = stamp, kind, stamp
    for name, value in zip(VALUES, values, strict=False):
        rows[name] = value
    return rows


def topic_rows(run: Run) -> dict[SampleKind, SampleRows]:
    """Return the samples of a recording by kind, in the order of reception."""
    states = run.gait_state
    gaits = sample_rows(
        SampleKind.GAIT, states.stamp, *(getattr(states, name) for name in GAIT_VALUES)
    )
    gaits["onset"], gaits["state"], gaits["run"] = states.onset, states.state, states.run
    gaits["cycle"] = states.cycle
    tracker, power = run.tracker, run.power
    return {
        SampleKind.GAIT: gaits,
        SampleKind.COMMAND: sample_rows(
            SampleKind.COMMAND, run.commanded.stamp, run.commanded.length_change
        ),
        SampleKind.LENGTH: sample_rows(SampleKind.LENGTH, run.measured.stamp, run.measured.length),
        SampleKind.POSITION: sample_rows(
            SampleKind.POSITION, tracker.stamp, tracker.rear_position, tracker.front_position
        ),
        SampleKind.POWER: sample_rows(SampleKind.POWER, power.stamp, power.valid_power),
    }


@dataclass(frozen=True)
class DriverState:
    """State of the driver, valid from ``stamp_ns`` on.

    ``onset_ns``, ``run`` and ``cycle`` are 0 if unknown; ``gait`` is None without an admissible gait.
    """

    stamp_ns: int
    activity: Activity
    gait: Gait | None = None
    onset_ns: int = 0
    run: int = 0
    cycle: int = 0


def driver_state_of(row: Any) -> DriverState:
    """Return the driver state of a sample of kind GAIT; an inadmissible gait is replaced by None."""
    gait: Gait | None = None
    with suppress(GaitError):
        gait = gait_of({name: row[value] for name, value in GAIT_VALUES.items()})
    activity = Activity(int(row["state"]))
    identity = int(row["onset"]), int(row["run"]), int(row["cycle"])
    return DriverState(int(row["sent"]), activity, gait, *identity)
