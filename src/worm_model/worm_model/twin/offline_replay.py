# SPDX-License-Identifier: Apache-2.0
"""Replay: the twin processes a recording offline, with a reproducible result.

If the recording contains the live twin's memory at rest before the first gait, the replay begins with this memory.
Otherwise the deflection of the fins at this gait is unknown, and the twin assumes that only load and pretension deflect
them. If this assumption does not explain the first cycle, the twin estimates the deflection from this cycle, and then
processes the recording again. A gait during which the clock was set is not judged.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from worm_model.parameters import Parameters
from worm_model.run import SAME_ONSET_NS, GaitStates, Run
from worm_model.twin.data.records import Event
from worm_model.twin.data.samples import NO_SAMPLES, SampleRows
from worm_model.twin.recorded_samples import RecordedSamples
from worm_model.twin.run_margins import NO_MARGINS
from worm_model.twin.start_estimate import Start
from worm_model.twin.stored_memory import add_past, memory_to_resume
from worm_model.twin.twin import CLOCK_SET, FOREVER_NS, ClosedCycle, Output, Twin, TwinState

# smallest number of impossible steps of the command that shows overlapping time spans
IMPOSSIBLE_STEPS = 3

Series = dict[str, NDArray[Any]]


@dataclass(frozen=True)
class Replay:
    """Result of the twin for a recording. Each series contains one array (n,) per field, by name.

    Attributes:
        states: fields of STATE_ROW (the message TwinState) except the margins, see `Output.states`.
        residuals: fields of RESIDUAL_ROW: the fields of TwinResiduals without its message; in addition, size and level
            of each channel and the number of the warning.
        lengths: fields of LENGTH_ROW, the estimated lengths (BodyLength).
        notices: events of the twin (TwinEvent).
        dropped: number of excluded samples, by reason.
        cycles: cycles that ended, each with the reason if it was not judged.
        unusable: reasons why runs cannot be judged, by run number (by onset in ns for runs without a number).
    """

    states: Series
    residuals: Series
    lengths: Series
    notices: tuple[Event, ...] = ()
    dropped: dict[str, int] | None = None
    cycles: tuple[ClosedCycle, ...] = ()
    unusable: Mapping[int, str] = field(default_factory=dict)


class Consumer(Protocol):
    """Object that receives the output of a replay, part by part."""

    def add(self, rows: SampleRows, output: Output) -> None:
        """Process some samples and the output of the twin for them."""


Result = TypeVar("Result", bound=Consumer)


class OfflineReplay:
    """Replay of a recording, part by part, which can be repeated.

    Args:
        parts: returns the recording in parts, in the order of reception.
        parameters: parameters of the robot.

    Attributes:
        samples: samples of the recording.
        unusable: reasons why runs cannot be judged, by run number (by onset in ns for runs without a number).
        dropped: number of excluded samples, by reason.
    """

    def __init__(self, parts: Callable[[], Iterable[Run]], parameters: Parameters) -> None:
        self._twin = Twin(parameters)
        self.samples = RecordedSamples(parts)
        states = self.samples.gait_state
        onsets = (int(states.onset[of].min()) for of in states.rows_of_runs())
        self._memory = memory_to_resume(
            self.samples.memories, parameters, min(onsets, default=FOREVER_NS)
        )
        self._starts: dict[int, Start] = {}
        self.unusable: Mapping[int, str] = {}
        self.dropped: dict[str, int] = {}

    def feed(self, begin: Callable[[], Result]) -> Result:
        """Return a consumer to which the whole replay has been added.

        If the twin estimates the start of a gait, the recording is processed again with this start and with a new
        consumer from ``begin``.
        """
        is_settled = self._memory is not None or bool(self._starts)
        consumer = begin()
        for rows, output in self.steps():
            consumer.add(rows, output)
        return consumer if is_settled or not self._starts else self.feed(begin)

    def steps(self) -> Iterator[tuple[SampleRows, Output]]:
        """Yield the samples in parts, each part with the output of the twin."""
        twin, unusable = self._twin, unusable_runs(self.samples)
        state = TwinState(twin.start().memory, unusable=unusable, starts=dict(self._starts))
        resumed_ns = -FOREVER_NS
        if self._memory is not None:
            resumed_ns = self._memory.stamp_ns
            self._memory.resume(state.memory)
        for rows in self.samples.rows():
            new = np.flatnonzero(rows["stamp"] > resumed_ns)
            first = int(new[0]) if new.size else len(rows)
            if first:
                add_past(state.memory, rows[:first])
            if new.size:
                resumed_ns = -FOREVER_NS  # a clock that goes back later is another matter
            yield rows, twin.advance(state, rows[first:])
        yield NO_SAMPLES, twin.advance(state, NO_SAMPLES, to_the_end=True)
        self._starts = self._starts or state.starts
        self.unusable = state.unusable
        self.dropped = {name: n for name, n in state.counts.items() if n and name != "taken"}


def replay_run(run: Run, parameters: Parameters) -> Replay:
    """Return the result of the twin for a recording."""
    replay = OfflineReplay(lambda: (run,), parameters)
    outputs = replay.feed(_Outputs).outputs
    states = _columns([output.motion for output in outputs])
    return Replay(
        states={name: column for name, column in states.items() if name not in NO_MARGINS},
        residuals=_columns([output.residuals for output in outputs]),
        lengths=_columns([output.lengths for output in outputs]),
        notices=tuple(event for output in outputs for event in output.events),
        dropped=replay.dropped,
        cycles=tuple(cycle for output in outputs for cycle in output.cycles),
        unusable=replay.unusable,
    )


class _Outputs:
    """Consumer that stores all outputs."""

    def __init__(self) -> None:
        self.outputs: list[Output] = []

    def add(self, rows: SampleRows, output: Output) -> None:  # noqa: ARG002 - a consumer's signature
        self.outputs.append(output)


def unusable_runs(samples: RecordedSamples) -> dict[int, str]:
    """Return the runs during which the clock was set, with the reason why they cannot be judged.

    Keys are run numbers, or onsets in ns for runs without a number. If log times and stamps were both set back, the
    order of the messages in a bag does not reveal this. Either of two other facts reveals it: the driver reports
    another onset for the same run, or the command alternates between two values where two time spans overlap.
    """
    states, found = samples.gait_state, {}
    for rows in states.rows_of_runs():
        onsets = states.onset[rows]
        number, first = int(states.run[rows[0]]), int(onsets.min())
        moved = float(onsets[-1] - onsets[0]) * 1e-9
        steps = samples.impossible_steps
        inside = (steps[:, 0] >= first) & (steps[:, 1] <= _end_of(states, rows))
        if number and np.ptp(onsets) > SAME_ONSET_NS:
            found[number] = CLOCK_SET.format(f" by {moved:+.1f} s" if moved else "")
        elif np.count_nonzero(inside) >= IMPOSSIBLE_STEPS:
            found[number or first] = CLOCK_SET.format("")
    return found


def _end_of(states: GaitStates, rows: NDArray[np.int64]) -> int:
    later = states.stamp[(states.stamp > states.stamp[rows[-1]]) & ~states.played]
    return int(later.min(initial=np.iinfo(np.int64).max))


def _columns(parts: Sequence[np.ndarray]) -> Series:
    rows = np.concatenate(parts)
    assert rows.dtype.names is not None
    return {name: np.ascontiguousarray(rows[name]) for name in rows.dtype.names}
