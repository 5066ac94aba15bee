# SPDX-License-Identifier: Apache-2.0
"""Replay: the twin processes a recording offline, with a reproducible result.

If the recording contains a memory of the live twin, the replay resumes from this memory. Otherwise the deflection of
the fins at the first gait is unknown, and the twin assumes that only load and pretension deflect them. If this
assumption does not explain the first cycle, the twin estimates the deflection from this cycle, and then processes the
recording again. A gait during which the clock was set is not judged.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from worm_model.parameters import Parameters
from worm_model.run import SAME_ONSET_NS, GaitStates, Run
from worm_model.twin.data.records import Event
from worm_model.twin.data.samples import NO_SAMPLES, SampleRows
from worm_model.twin.recorded_samples import RecordedSamples
from worm_model.twin.start_estimate import Start
from worm_model.twin.stored_memory import StoredMemory, look_back_ns, memory_to_resume
from worm_model.twin.twin import CLOCK_SET, ClosedCycle, Output, Twin, TwinState

# smallest number of impossible steps of the command that shows overlapping time spans
IMPOSSIBLE_STEPS = 3

Series = dict[str, NDArray[Any]]


@dataclass(frozen=True)
class Replay:
    """Result of the twin for a recording. Each series contains one array (n,) per field, by name.

    Attributes:
        states: fields of STATE_ROW (the message TwinState).
        residuals: fields of RESIDUAL_ROW: the fields of TwinResiduals without its message; in addition, size and level
            of each channel and the number of the warning.
        lengths: fields of LENGTH_ROW, the estimated lengths (BodyLength).
        notices: events of the twin (TwinEvent).
        dropped: number of excluded samples, by reason.
        cycles: cycles that ended, each with the reason if it was not judged.
        unusable: reasons why runs cannot be judged, by run number (by onset in ns for runs without a number).
        resumed_ns: stamp of the stored memory from which the replay resumed, ns; 0 without one.
    """

    states: Series
    residuals: Series
    lengths: Series
    notices: tuple[Event, ...] = ()
    dropped: dict[str, int] | None = None
    cycles: tuple[ClosedCycle, ...] = ()
    unusable: Mapping[int, str] = field(default_factory=dict)
    resumed_ns: int = 0


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
        resumed_ns: stamp of the stored memory from which the replay resumes, ns; 0 without one.
        unusable: reasons why runs cannot be judged, by run number (by onset in ns for runs without a number).
        dropped: number of excluded samples, by reason.
    """

    def __init__(self, parts: Callable[[], Iterable[Run]], parameters: Parameters) -> None:
        self._twin = twin = Twin(parameters)
        jump_back_ns = round(twin.settings.jump_back_s * 1e9)
        self.samples = RecordedSamples(parts, jump_back_ns, lambda memory: memory.holds_for(twin))
        states = self.samples.gait_state
        onsets = [int(states.onset[of].min()) for of in states.rows_of_runs()]
        self._memory = memory_to_resume(self.samples.memories, self.samples.first_ns, onsets)
        self._starts: dict[int, Start] = {}
        self.resumed_ns = 0 if self._memory is None else self._memory.stamp_ns
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
        if self._memory is not None:
            before = yield from self._steps_before(self._memory, state)
            resumed = self._memory.resume(twin, before)
            resumed.unusable |= state.unusable
            state = resumed
        for rows in self.samples.rows():
            new = rows if self._memory is None else rows[self._memory.is_new(rows)]
            yield new, twin.advance(state, new)
        yield NO_SAMPLES, twin.advance(state, NO_SAMPLES, to_the_end=True)
        self._starts = self._starts or state.starts
        self.unusable = state.unusable
        self.dropped = {name: n for name, n in state.counts.items() if n and name != "taken"}

    def _steps_before(
        self, memory: StoredMemory, state: TwinState
    ) -> Generator[tuple[SampleRows, Output], None, SampleRows]:
        """Yield the steps up to a stored memory, and return the last samples before this memory."""
        last = NO_SAMPLES
        if self.samples.first_ns is None or self.samples.first_ns > memory.stamp_ns:
            return last
        for rows in self.samples.rows(memory.until_ns):
            old = rows[~memory.is_new(rows)]
            last = np.concatenate([last, old])
            last = last[last["stamp"] >= memory.stamp_ns - look_back_ns(self._twin)]
            yield old, _apart(self._twin.advance(state, old))
        yield NO_SAMPLES, _apart(self._twin.advance(state, NO_SAMPLES, to_the_end=True))
        return last


def replay_run(run: Run, parameters: Parameters) -> Replay:
    """Return the result of the twin for a recording."""
    replay = OfflineReplay(lambda: (run,), parameters)
    outputs = replay.feed(_Outputs).outputs
    return Replay(
        states=_columns([output.states for output in outputs]),
        residuals=_columns([output.residuals for output in outputs]),
        lengths=_columns([output.lengths for output in outputs]),
        notices=tuple(event for output in outputs for event in output.events),
        dropped=replay.dropped,
        cycles=tuple(cycle for output in outputs for cycle in output.cycles),
        unusable=replay.unusable,
        resumed_ns=replay.resumed_ns,
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


def _apart(output: Output) -> Output:
    """Return an output with negated numbers of warnings, so that they differ from those after the memory."""
    output.residuals["warning"] *= -1
    return Output(
        output.states,
        output.residuals,
        output.lengths,
        output.events,
        {-number: text for number, text in output.warnings.items()},
        output.cycles,
    )


def _columns(parts: Sequence[np.ndarray]) -> Series:
    rows = np.concatenate(parts)
    assert rows.dtype.names is not None
    return {name: np.ascontiguousarray(rows[name]) for name in rows.dtype.names}
