# SPDX-License-Identifier: Apache-2.0
"""Offline run of the twin over a recording, with a reproducible result.

If the recording contains the live twin's memory, the replay resumes from it. Otherwise the state of the fins at the
first gait is unknown: the twin estimates it at the end of the first cycle, and follows the recording again from that
start. A gait during which the clock was set is not judged.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from worm_model.parameters import Parameters
from worm_model.run import SAME_ONSET_NS, GaitStates, Run
from worm_model.twin.records import Event, Health, residual_message
from worm_model.twin.samples import Rows, rows_of_run
from worm_model.twin.stored_memory import StoredMemory, memory_to_resume, read_memory
from worm_model.twin.twin import CLOCK_SET, ClosedCycle, Output, Twin, TwinState

IMPOSSIBLE_SPEED = 1.0  # m/s; no gait moves the cable faster than 0.12 m/s
IMPOSSIBLE_STEPS = 3  # number of impossible steps of the command that proves overlapping times

Series = dict[str, NDArray[Any]]


@dataclass(frozen=True)
class Replay:
    """Result of the twin for a recording; each series has one column per field of its record, by name.

    Attributes:
        states: columns of StateRecord (the message TwinState).
        residuals: columns of ResidualRecord (TwinResiduals) without `messages`, with sizes and levels of the channels.
        lengths: `stamp_ns`, `length`, `length_change` (BodyLength, ESTIMATED).
        notices: events of the twin (TwinEvent).
        warnings: texts to which residuals refer by number.
        dropped: number of samples that were dropped, by reason.
        cycles: cycles that ended, each with the reason if it was not judged.
        unusable: reasons why runs cannot be judged, by run number (by onset in ns for runs without one).
        resumed_ns: stamp of the stored memory from which the replay resumed, 0 without one.
    """

    states: Series
    residuals: Series
    lengths: Series
    notices: tuple[Event, ...] = ()
    warnings: dict[int, str] | None = None
    dropped: dict[str, int] | None = None
    cycles: tuple[ClosedCycle, ...] = ()
    unusable: Mapping[int, str] = field(default_factory=dict)
    resumed_ns: int = 0

    @cached_property
    def messages(self) -> tuple[str, ...]:
        """Messages of the residuals."""
        series = self.residuals
        texts = [""] * len(series["stamp_ns"])
        for row in np.flatnonzero(series["health"] > Health.HEALTHY).tolist():
            line = {name: column[row] for name, column in series.items()}
            texts[row] = residual_message(line, self.warnings or {})
        return tuple(texts)


def replay_run(run: Run, parameters: Parameters) -> Replay:
    """Return the result of the twin for a recording."""
    twin = Twin(parameters)
    rows = rows_of_run(run, round(twin.settings.jump_back_s * 1e9))
    unusable = unusable_runs(run)
    memory = _memory(run, twin, rows)
    outputs, state = _follow(twin, rows, memory, TwinState(twin.start().memory, unusable=unusable))
    if state.starts and memory is None:
        begun = TwinState(twin.start().memory, unusable=unusable_runs(run), starts=state.starts)
        outputs, state = _follow(twin, rows, memory, begun)
    return Replay(
        states=_columns([output.states for output in outputs]),
        residuals=_columns([output.residuals for output in outputs]),
        lengths=_columns([output.lengths for output in outputs]),
        notices=tuple(event for output in outputs for event in output.events),
        warnings={number: text for output in outputs for number, text in output.warnings.items()},
        dropped={name: n for name, n in state.counts.items() if n and name != "taken"},
        cycles=tuple(cycle for output in outputs for cycle in output.cycles),
        unusable=state.unusable,
        resumed_ns=memory.stamp_ns if memory is not None else 0,
    )


def unusable_runs(run: Run) -> dict[int, str]:
    """Return the runs during which the clock was set, with the reason why they cannot be judged.

    Keys are run numbers, or onsets in ns for runs without a number. If log times and stamps were both set back, the
    order of a bag's messages shows nothing. But the driver then reports another onset of the same run. Where two time
    spans overlap, the command alternates between two values.
    """
    states, found = run.gait_state, {}
    for rows in states.rows_of_runs():
        onsets = states.onset[rows]
        number, first = int(states.run[rows[0]]), int(onsets.min())
        moved = float(onsets[-1] - onsets[0]) * 1e-9
        if number and np.ptp(onsets) > SAME_ONSET_NS:
            found[number] = CLOCK_SET.format(f" by {moved:+.1f} s" if moved else "")
        elif _jumps_to_and_fro(run, first, _end_of(states, rows)):
            found[number or first] = CLOCK_SET.format("")
    return found


def _end_of(states: GaitStates, rows: NDArray[np.int64]) -> int:
    later = states.stamp[(states.stamp > states.stamp[rows[-1]]) & ~states.played]
    return int(later.min(initial=np.iinfo(np.int64).max))


def _jumps_to_and_fro(run: Run, first: int, last: int) -> bool:
    stamp, change = run.commanded.stamp, run.commanded.length_change
    inside = np.flatnonzero((stamp >= first) & (stamp <= last))
    inside = inside[np.argsort(stamp[inside], kind="stable")]
    step, duration = np.abs(np.diff(change[inside])), np.diff(stamp[inside]) * 1e-9
    return int(np.sum(step > IMPOSSIBLE_SPEED * duration + 1e-3)) >= IMPOSSIBLE_STEPS


def _memory(run: Run, twin: Twin, rows: Rows) -> StoredMemory | None:
    """Return the stored memory from which to follow a recording; None if there is none for this twin."""
    stored = zip(run.memory.stamp.tolist(), run.memory.content.tolist(), strict=True)
    memories = [memory for stamp, text in stored if (memory := read_memory(stamp, text))]
    memories = [memory for memory in memories if memory.holds_for(twin)]
    states = run.gait_state
    onsets = [int(states.onset[of].min()) for of in states.rows_of_runs()]
    return memory_to_resume(sorted(memories, key=lambda m: m.stamp_ns), rows, onsets)


def _follow(
    twin: Twin, rows: Rows, memory: StoredMemory | None, state: TwinState
) -> tuple[list[Output], TwinState]:
    """Return the outputs in order, and the final state of the twin."""
    if memory is None:
        return [twin.advance(state, rows, to_the_end=True)], state
    new = memory.is_new(rows)
    earlier = rows[~new]
    outputs = []
    if np.any(earlier["kind"] != 0):
        outputs = [_apart(twin.advance(state, earlier, to_the_end=True))]
    resumed = memory.resume(twin, earlier)
    resumed.unusable |= state.unusable
    resumed.starts = state.starts
    return [*outputs, twin.advance(resumed, rows[new], to_the_end=True)], resumed


def _apart(output: Output) -> Output:
    """Return an output with negative numbers of warnings, which no other output uses."""
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
