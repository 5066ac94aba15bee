# SPDX-License-Identifier: Apache-2.0
"""Samples for the twin with names, as tests write them, and the twin's output for them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple, dataclass
from types import SimpleNamespace
from typing import ClassVar

import numpy as np

from worm_model.parameters import PAPER
from worm_model.run import (
    GaitStates,
    LengthSamples,
    MemorySamples,
    PowerSamples,
    Run,
    TrackerSamples,
)
from worm_model.twin.data.records import Event, residual_message
from worm_model.twin.data.samples import (
    GAIT_VALUES,
    NO_SAMPLES,
    SAMPLE,
    VALUES,
    DriverState,
    SampleKind,
)
from worm_model.twin.recorded_samples import RecordedSamples
from worm_model.twin.twin import Twin, TwinState

ONSET = 1_700_000_000_000_000_000  # stamp of the onset of a test's first run, ns


def at(time: float) -> int:
    """Return the stamp of a time in s after the onset."""
    return ONSET + round(time * 1e9)


@dataclass(frozen=True)
class _Instrument:
    """Sample with a stamp and the values of its kind."""

    kind: ClassVar[SampleKind]
    stamp_ns: int

    def row(self) -> tuple:
        stamp, *values = astuple(self)
        none = (0.0,) * (len(VALUES) - len(values))
        return (stamp, self.kind, 0, 0, 0, 0, stamp, *values, *none)


@dataclass(frozen=True)
class CommandedLength(_Instrument):
    kind = SampleKind.COMMAND
    length_change: float


@dataclass(frozen=True)
class MeasuredLength(_Instrument):
    kind = SampleKind.LENGTH
    length: float


@dataclass(frozen=True)
class TrackerSample(_Instrument):
    kind = SampleKind.POSITION
    rear_position: float
    front_position: float


@dataclass(frozen=True)
class PowerSample(_Instrument):
    kind = SampleKind.POWER
    power: float


class GaitSample(DriverState):
    def row(self) -> tuple:
        none = (0.0,) * len(VALUES)
        gait = none if self.gait is None else astuple(self.gait)
        head = (self.onset_ns, self.activity, self.run, self.cycle, self.stamp_ns)
        return (self.stamp_ns, SampleKind.GAIT, *head, *gait)


Sample = _Instrument | GaitSample


def rows_of(samples: Sequence[Sample]) -> np.ndarray:
    return np.array([sample.row() for sample in samples], SAMPLE)


@dataclass(frozen=True)
class TwinOutput:
    """Output of the twin, in records with attributes; residuals have a ``message``."""

    states: list
    residuals: list
    lengths: list
    notices: list[Event]


def follow(
    samples: Sequence[Sample],
    twin: Twin | None = None,
    *,
    chunk: int = 0,
    state: TwinState | None = None,
    end: bool = True,
) -> TwinOutput:
    """Pass the samples to a twin, ``chunk`` at a time (0: all at once), to the end."""
    twin = twin or Twin()
    state = state or twin.start()
    rows = rows_of(samples)
    chunk = chunk or max(len(rows), 1)
    outputs = [twin.advance(state, rows[k : k + chunk]) for k in range(0, len(rows), chunk)]
    if end:
        outputs.append(twin.advance(state, rows[:0], to_the_end=True))
    return TwinOutput(
        states=[_record(row) for output in outputs for row in output.states],
        residuals=[
            _record(row, residual_message(row, output.warnings))
            for output in outputs
            for row in output.residuals
        ],
        lengths=[_record(row) for output in outputs for row in output.lengths],
        notices=[event for output in outputs for event in output.events],
    )


def _record(row: np.void, message: str = "") -> SimpleNamespace:
    """Return a row with attributes; in its text NaN equals itself."""
    return SimpleNamespace(message=message, **dict(zip(row.dtype.names, row.item(), strict=True)))


def rows_of_run(run: Run) -> np.ndarray:
    """Return all samples of a run for the twin, in the order of `RecordedSamples.rows`."""
    return np.concatenate([NO_SAMPLES, *RecordedSamples(lambda: (run,)).rows()])


def run_of_rows(rows: np.ndarray, memories: Sequence[tuple[int, str]] = ()) -> Run:
    """Return rows of SAMPLE in order of reception as a recorded run, with stored memories (stamp in ns, text)."""

    def of(kind: SampleKind) -> np.ndarray:
        return rows[rows["kind"] == kind]

    gait, command, power = of(SampleKind.GAIT), of(SampleKind.COMMAND), of(SampleKind.POWER)
    length, tracker = of(SampleKind.LENGTH), of(SampleKind.POSITION)
    usual = PAPER.initial_length
    return Run(
        origin=int(rows["stamp"].min()),
        commanded=LengthSamples(command["stamp"], command["a"] + usual, command["a"]),
        measured=LengthSamples(length["stamp"], length["a"], length["a"] - usual),
        tracker=TrackerSamples(tracker["stamp"], tracker["a"], tracker["b"]),
        power=PowerSamples(
            power["stamp"], 0 * power["stamp"], 0 * power["a"], 0 * power["a"], power["a"]
        ),
        gait_state=GaitStates(
            stamp=gait["stamp"],
            state=gait["state"],
            **{
                name: gait[value].astype(np.int64 if name in ("direction", "profile") else float)
                for name, value in GAIT_VALUES.items()
            },
            onset=gait["onset"],
            cycle=gait["cycle"],
            cycles=0 * gait["cycle"],
            run=gait["run"],
        ),
        memory=MemorySamples(
            np.array([stamp for stamp, _ in memories], np.int64),
            np.array([text for _, text in memories], object),
        ),
    )
