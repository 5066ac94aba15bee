# SPDX-License-Identifier: Apache-2.0
"""Missed and extra grooves of a run, cycle by cycle: what `worm_model.twin.observations` finds at each cycle's end."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from worm_model.twin.anchors import WINDOW, Anchors, Cycle, Move, close_anchors
from worm_model.twin.hypotheses import PHASES, Hypotheses, PowerWatch, close_watch
from worm_model.twin.observations import CLOSE_S, tells_of_length
from worm_model.twin.offline.instrument_comparison import Observations, Triggers
from worm_model.twin.offline.sample_timeline import Array, Irregular, Stamps
from worm_model.twin.records import NANOSECONDS
from worm_model.twin.twin_state import Run


@dataclass(frozen=True)
class Numbered:
    """Observations with the number of their cycle and its phase (NaN after the run), each (n,)."""

    seen: Observations
    number: NDArray[np.int64]
    phase: Array


def number_cycles(run: Run, seen: Observations) -> Numbered:
    """The cycles of observations of a run that has a gait; see `worm_model.twin.twin_state.Run.cycle_at`."""
    number, phase = _cycles(run, seen.stamp)
    return Numbered(seen, number, phase)


def _cycles(run: Run, stamp: Stamps) -> tuple[NDArray[np.int64], Array]:
    assert run.gait is not None
    elapsed = (stamp - run.start_ns) / NANOSECONDS / run.gait.period
    whole = np.floor(elapsed + 1e-9)
    number, phase = whole.astype(np.int64) + 1, np.maximum(elapsed - whole, 0.0)
    if run.end_ns:
        after, last = stamp >= run.end_ns, run.cycle_at(run.end_ns)
        assert last is not None
        number, phase = np.where(after, last.number, number), np.where(after, np.nan, phase)
    return number, phase


@dataclass(frozen=True)
class Closing:
    """A cycle has begun, and the one before is over, as a comparison (``trigger``) at ``stamp`` (ns) finds.

    ``row`` is the first observation in it, taken at ``place``; None if only its time has come.
    """

    cycle: Cycle
    trigger: int
    row: int | None
    place: int
    stamp: int


def closings(run: Run, numbered: Numbered, found: Triggers, next_ns: int) -> Iterator[Closing]:
    """Each end of one cycle or several, by the next observation, some time later, or the word of another run.

    ``next_ns`` is the stamp of that word, 0 if there is none.
    """
    over = found.now - round(CLOSE_S * NANOSECONDS)
    late, _ = _cycles(run, over)
    late = np.where(over < run.start_ns, 0, late)
    seen, cycle = numbered.seen, 1
    while True:
        row = int(np.searchsorted(numbered.number, cycle, side="right"))
        trigger = int(np.searchsorted(late, cycle, side="right"))
        by_row = row < len(seen.stamp) and int(seen.trigger[row]) <= trigger
        if by_row:
            stamp = int(seen.stamp[row])
            at = int(seen.trigger[row]), row, int(seen.place[row])
            closing = Closing(_cycle(run, stamp), *at, stamp)
        elif trigger < len(late):
            begun = replace(_cycle(run, int(over[trigger])), phase=math.nan)
            closing = Closing(begun, trigger, None, 0, int(found.now[trigger]))
        else:
            break
        yield closing
        cycle = closing.cycle.number
    if next_ns and run.end_ns:
        begun = replace(_cycle(run, run.end_ns), phase=math.nan)
        if begun.number > cycle:
            yield Closing(begun, len(late), None, 0, next_ns)


def _cycle(run: Run, stamp: int) -> Cycle:
    cycle = run.cycle_at(stamp)
    assert cycle is not None
    return cycle


@dataclass(frozen=True)
class Finding:
    """What the end of a cycle told, a warning until ``until_ns``; the move of the anchors, None if power told."""

    closing: Closing
    text: str
    until_ns: int
    move: Move | None = None


@dataclass(frozen=True)
class Positions:
    """Position residuals in m with the moves followed, and what of them no move explains, each (n,)."""

    residual: Array
    fault: Array


def watch_anchors(
    run: Run, numbered: Numbered, off: Array, ends: Iterable[Closing], pitch: float
) -> tuple[Anchors, Positions, list[Finding]]:
    """(the anchors in the end, the residuals, what happened) from positions off by ``off`` (n,) m without any move.

    Raises:
        Irregular: the grooves tell of another L0.
    """
    anchors, findings, seen = Anchors(), [], numbered.seen
    residual, fault = off.copy(), off.copy()
    for closing in ends:
        first, last = np.searchsorted(numbered.number, [anchors.cycle, anchors.cycle + 1])
        in_time = np.searchsorted(seen.trigger, closing.trigger, side="right")
        own = slice(first, min(last, in_time))
        near_end = residual[own][numbered.phase[own] >= 1.0 - WINDOW]
        anchors = replace(anchors, residuals=tuple(near_end.tolist()))
        anchors, text = close_anchors(anchors, closing.cycle, pitch, run.direction)
        if not text:
            continue
        if not run.length_seen and tells_of_length(anchors):
            raise Irregular
        move, row = anchors.moves[-1], closing.row
        later = seen.trigger > closing.trigger if row is None else np.arange(len(off)) > row
        fault[later] -= move.grooves * pitch
        residual[later & (seen.stamp >= move.stamp_ns)] -= move.grooves * pitch
        findings.append(Finding(closing, text, _until(run, closing), move))
    return anchors, Positions(residual, fault), findings


def _until(run: Run, closing: Closing) -> int:
    assert run.gait is not None
    return closing.cycle.start_ns + round(run.gait.period * NANOSECONDS)


def watch_power(
    run: Run, numbered: Numbered, ends: Iterable[Closing], pair: Hypotheses
) -> tuple[PowerWatch, list[Finding]]:
    """(the watch in the end, the alarms) of a gait whose power can tell."""
    watch, findings = PowerWatch(), []
    inside = np.isfinite(numbered.phase)
    phase = np.minimum((numbered.phase[inside] * PHASES).astype(np.int64), PHASES - 1)
    difference = np.array(pair.difference)[phase]
    excess = numbered.seen.value[inside] - np.array(pair.expected)[phase]
    number, trigger = numbered.number[inside], numbered.seen.trigger[inside]
    for closing in ends:
        first, last = np.searchsorted(number, [watch.cycle, watch.cycle + 1]).tolist()
        last = min(last, int(np.searchsorted(trigger, closing.trigger, side="right")))
        own = slice(first, last)
        watch = replace(
            watch,
            projection=float(excess[own] @ difference[own]),
            norm=float(difference[own] @ difference[own]),
            samples=max(last - first, 0),
        )
        watch, text = close_watch(watch, closing.cycle.number, pair)
        if text:
            findings.append(Finding(closing, text, _until(run, closing)))
    return watch, findings
