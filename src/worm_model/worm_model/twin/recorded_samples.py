# SPDX-License-Identifier: Apache-2.0
"""Samples of a recording, read part by part and returned in the order in which a replay processes them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from worm_model.arrays import Stamps
from worm_model.run import GaitStates, LengthSamples, Run, concatenated
from worm_model.twin.core.sample_buffer import JUMP_BACK_NS
from worm_model.twin.data.samples import NO_SAMPLES, SampleKind, SampleRows, topic_rows
from worm_model.twin.stored_memory import NEAR_NS

# m/s; faster changes of the command count as impossible. The gaits of the paper's box stay below 0.12 m/s.
IMPOSSIBLE_SPEED = 1.0
_FOREVER = int(np.iinfo(np.int64).max)
# Place of a sample in the order: number of backward jumps of the clock before it, and its stamp in ns
_Place = tuple[int, int]


class RecordedSamples:
    """Samples of a recording, ordered by stamp, so that none is late.

    If the stamps of a topic go back by more than `JUMP_BACK_NS` and stay there, the clock has jumped. All samples
    after the jump then follow all samples before the jump. Each call of `rows` reads the parts once, and so does the
    constructor (twice if the stamps of the command go back). `rows` keeps in memory one part, and those earlier samples
    that a sample of a later part may have to precede.

    Args:
        parts: returns the recording in parts, in the order of reception.

    Attributes:
        origin: smallest origin of the parts, ns; 0 without samples.
        first_ns: smallest stamp of all samples except driver states, ns; None without samples.
        last_ns: largest of the last stamps of command, measured length and tracker, ns; None without samples.
        gait_state: all driver states.
        memories: stamp (ns) and text of the stored memories near `first_ns`.
        impossible_steps: stamps (n, 2) before and after impossibly fast steps of the command, in order of stamp.
        clock_went_back: True if the clock has jumped back.
    """

    def __init__(self, parts: Callable[[], Iterable[Run]]) -> None:
        self._parts = parts
        self._stretches: list[list[tuple[SampleKind, int, int]]] = []
        self.memories: list[tuple[int, str]] = []
        self.first_ns: int | None = None
        first_ns: dict[SampleKind, int] = {}
        jumps = {kind: _Jumps() for kind in SampleKind}
        origins, states = [], []
        last_ns: dict[SampleKind, int] = {}
        steps = [np.zeros((0, 2), np.int64)]
        command, is_ordered = LengthSamples(), True
        for part in parts():
            origins += [part.origin] if part.origin else []
            states.append(part.gait_state)
            self._stretches.append([])
            for kind, rows in topic_rows(part).items():
                if not len(rows):
                    continue
                stamps = rows["stamp"]
                found = jumps[kind].add(stamps)
                self._stretches[-1] += [(kind, *stretch) for stretch in found]
                if kind != SampleKind.GAIT:
                    first_ns[kind] = min(int(stamps.min()), first_ns.get(kind, _FOREVER))
                if kind in (SampleKind.COMMAND, SampleKind.LENGTH, SampleKind.POSITION):
                    last_ns[kind] = int(stamps[-1])
            self.first_ns = min(first_ns.values(), default=None)
            command = concatenated(LengthSamples, [_last_of(command), part.commanded])
            is_ordered &= not (np.diff(command.stamp) < 0).any()
            steps.append(_impossible_steps(command))
            self._add_memories(part)
        self.origin = min(origins, default=0)
        self.last_ns = max(last_ns.values(), default=None)
        self.gait_state: GaitStates = concatenated(GaitStates, states)
        self._jumps = {kind: found.finish() for kind, found in jumps.items()}
        self.clock_went_back = any(len(found) for found in self._jumps.values())
        if not is_ordered:
            command = concatenated(LengthSamples, [part.commanded for part in parts()])
            steps = [_impossible_steps(command)]
        self.impossible_steps: NDArray[np.int64] = np.concatenate(steps)

    def rows(self) -> Iterator[SampleRows]:
        """Yield the samples in order, in blocks."""
        counts = dict.fromkeys(SampleKind, 0)
        waiting, jumps = NO_SAMPLES, np.zeros(0, np.int64)
        places = self._smallest_places()
        for part, (number, stamp) in zip(self._parts(), places, strict=True):
            found = [(waiting, jumps)]
            for kind, rows in topic_rows(part).items():
                index = np.arange(counts[kind], counts[kind] + len(rows))
                counts[kind] += len(rows)
                found.append((rows, np.searchsorted(self._jumps[kind], index, side="right")))
            waiting, jumps = (np.concatenate(each) for each in zip(*found, strict=True))
            order = np.lexsort((waiting["kind"], waiting["stamp"], jumps))
            ready = ((jumps < number) | ((jumps == number) & (waiting["stamp"] < stamp)))[order]
            yield waiting[order[ready]]
            waiting, jumps = waiting[order[~ready]], jumps[order[~ready]]

    def _smallest_places(self) -> list[_Place]:
        """Return for each part the smallest place of all samples in later parts."""
        smallest, places = (_FOREVER, 0), []
        for stretches in reversed(self._stretches):
            places.append(smallest)
            for kind, index, stamp in stretches:
                number = int(np.searchsorted(self._jumps[kind], index, side="right"))
                smallest = min(smallest, (number, stamp))
        return places[::-1]

    def _add_memories(self, part: Run) -> None:
        memory = part.memory
        self.memories += zip(memory.stamp.tolist(), memory.content.tolist(), strict=True)
        if self.first_ns is not None:
            first = self.first_ns
            self.memories = [each for each in self.memories if abs(each[0] - first) <= NEAR_NS]


class _Jumps:
    """Backward jumps of the clock in the stamps of a topic, which are added part by part."""

    def __init__(self) -> None:
        self._count = 0
        self._newest = 0  # largest stamp before the tail
        self._tail: Stamps = np.zeros(0, np.int64)  # the last two stamps
        self._found: list[int] = []

    def add(self, stamp: Stamps) -> list[tuple[int, int]]:
        """Add the stamps of a part; return (first index, smallest stamp) of each stretch without a step back."""
        stamps = np.concatenate([self._tail, stamp])
        first = self._count - len(self._tail)
        newest = np.maximum.accumulate(np.append(self._newest, stamps))[1:]
        back = np.flatnonzero(np.diff(stamps) < -JUMP_BACK_NS)
        # After a single late sample, the stamps return to the newest. After a jump, they stay behind the newest.
        decided = back[back + 2 < len(stamps)]
        stays = stamps[decided + 2] < newest[decided] - JUMP_BACK_NS
        self._found += (first + decided[stays] + 1).tolist()
        borders = back + 1 - len(self._tail)
        borders = np.append(0, borders[borders > 0])
        self._count += len(stamp)
        self._newest = int(newest[-3]) if len(newest) > 2 else 0
        self._tail = stamps[-2:]
        smallest = np.minimum.reduceat(stamp, borders)
        return list(
            zip((self._count - len(stamp) + borders).tolist(), smallest.tolist(), strict=True)
        )

    def finish(self) -> NDArray[np.int64]:
        """Return the index of the first sample after each jump. All stamps must have been added before."""
        last = self._tail
        if len(last) == 2 and last[1] - last[0] < -JUMP_BACK_NS:
            self._found.append(self._count - 1)
        return np.array(self._found, np.int64)


def _last_of(samples: LengthSamples) -> LengthSamples:
    return LengthSamples(samples.stamp[-1:], samples.length[-1:], samples.length_change[-1:])


def _impossible_steps(commanded: LengthSamples) -> NDArray[np.int64]:
    """Return the stamps (n, 2) before and after each step of the command over 1 mm beyond `IMPOSSIBLE_SPEED`."""
    order = np.argsort(commanded.stamp, kind="stable")
    stamp, change = commanded.stamp[order], commanded.length_change[order]
    step, duration = np.abs(np.diff(change)), np.diff(stamp) * 1e-9
    rows = np.flatnonzero(step > IMPOSSIBLE_SPEED * duration + 1e-3)
    return np.stack([stamp[rows], stamp[rows + 1]], axis=1)
