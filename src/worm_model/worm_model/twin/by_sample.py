# SPDX-License-Identifier: Apache-2.0
"""A recording through the twin sample by sample, by rising stamp, which is what a live twin makes of them, too."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, get_type_hints

import numpy as np
from numpy.typing import NDArray

from worm_model.gait import Gait, GaitError
from worm_model.parameters import Parameters
from worm_model.run import GaitStates, Run
from worm_model.twin.core import Twin
from worm_model.twin.records import (
    Activity,
    CommandedLength,
    GaitSample,
    LengthRecord,
    MeasuredLength,
    Notice,
    PowerSample,
    ResidualRecord,
    Sample,
    StateRecord,
    TrackerSample,
)
from worm_model.twin.twin_settings import DEFAULTS, TwinSettings

Series = dict[str, NDArray[Any]]


@dataclass(frozen=True)
class Replay:
    """What the twin made of a recording: each series is a column per field of its record, by name (see `series_of`).

    Attributes:
        states: of StateRecord (the message TwinState).
        residuals: of ResidualRecord (TwinResiduals), `message` apart.
        messages: the residuals' messages.
        lengths: of LengthRecord (BodyLength, ESTIMATED).
        notices: what the twin told on the way.
    """

    states: Series
    residuals: Series
    messages: tuple[str, ...]
    lengths: Series
    notices: tuple[Notice, ...]


def replay_samples(run: Run, parameters: Parameters, settings: TwinSettings = DEFAULTS) -> Replay:
    """Let the twin follow a recording, one sample after the other."""
    twin = Twin(parameters, settings)
    _, output = twin.step(twin.start(), samples_of(run))
    return Replay(
        states=series_of(StateRecord, output.states),
        residuals=series_of(ResidualRecord, output.residuals),
        messages=tuple(record.message for record in output.residuals),
        lengths=series_of(LengthRecord, output.lengths),
        notices=output.notices,
    )


def samples_of(run: Run) -> list[Sample]:
    """All samples that the twin takes, by rising stamp; of equal ones the gait state goes first."""
    samples: list[Sample] = list(gait_samples(run.gait_state))
    commanded, measured, tracker = run.commanded, run.measured, run.tracker
    samples += map(CommandedLength, commanded.stamp.tolist(), commanded.length_change.tolist())
    samples += map(MeasuredLength, measured.stamp.tolist(), measured.length.tolist())
    samples += map(
        TrackerSample,
        tracker.stamp.tolist(),
        tracker.rear_position.tolist(),
        tracker.front_position.tolist(),
    )
    samples += map(PowerSample, run.power.stamp.tolist(), run.power.valid_power.tolist())
    return sorted(samples, key=lambda sample: sample.stamp_ns)


def gait_samples(states: GaitStates) -> Iterable[GaitSample]:
    """In the order of reception."""
    for row in range(len(states.stamp)):
        yield GaitSample(
            int(states.stamp[row]),
            Activity(int(states.state[row])),
            _gait_at(states, row),
            int(states.onset[row]),
        )


def _gait_at(states: GaitStates, row: int) -> Gait | None:
    """The gait of a gait state; one that is not admissible counts as none."""
    try:
        return Gait(
            float(states.stroke[row]),
            float(states.frequency[row]),
            int(states.direction[row]),
            float(states.margin[row]),
        )
    except GaitError:
        return None


def series_of(kind: type, records: Sequence[Any]) -> Series:
    """Records of a kind as a column per numeric field: int64 where a record has a whole number, else float64."""
    return {
        name: np.array([getattr(record, name) for record in records], np.int64 if whole else float)
        for name, whole in _numbers_of(kind).items()
    }


@lru_cache
def _numbers_of(kind: type) -> dict[str, bool]:
    """The numeric fields of a kind of record, and whether each is a whole number."""
    return {name: issubclass(of, int) for name, of in get_type_hints(kind).items() if of is not str}
