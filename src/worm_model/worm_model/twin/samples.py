# SPDX-License-Identifier: Apache-2.0
"""Samples as rows: what the twin takes, live from messages and offline from a recording."""

from __future__ import annotations

import enum
from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from worm_model.run import Run

Rows = NDArray[np.void]
#: when samples were received, ns, by their `Kind`
Received = Mapping[int, NDArray[np.int64]]


class Kind(enum.IntEnum):
    """Of a sample, in the order in which those of one stamp are taken."""

    GAIT = 0
    COMMAND = 1
    LENGTH = 2
    POSITION = 3
    POWER = 4


#: ``stamp`` in ns. ``a`` to ``d`` by kind: u_cmd (m); L (m); x1, x2 (m); power (W); stroke (m), frequency (Hz),
#: direction, margin (m). ``onset`` (ns), ``state``, ``run``, ``cycle`` and ``heard``, its own stamp (ns), of a gait
#: state only.
SAMPLE = np.dtype(
    [
        *(
            (name, np.int64)
            for name in ("stamp", "kind", "onset", "state", "run", "cycle", "heard")
        ),
        *((name, np.float64) for name in ("a", "b", "c", "d")),
    ]
)


def sample_rows(kind: Kind, stamp: NDArray[np.int64], *values: NDArray[Any]) -> Rows:
    """Rows of one kind from stamps (n,) in ns and its values, each (n,)."""
    rows = np.zeros(len(stamp), SAMPLE)
    rows["stamp"], rows["kind"], rows["heard"] = stamp, kind, stamp
    for name, value in zip("abcd", values, strict=False):
        rows[name] = value
    return rows


def rows_of_run(run: Run, jump_back_ns: int, received: Received | None = None) -> Rows:
    """All samples that the twin takes, in the order in which they came, as far as stamps tell that.

    Each topic keeps its own order. Topics are interleaved by stamp; where one goes back by more than
    ``jump_back_ns`` the clock has jumped, and all after that comes after all before. A topic too rare to jump itself
    (the driver's words) has jumped with the others by when it was ``received`` (ns, by `Kind`), where that is known.
    """
    states = run.gait_state
    gaits = sample_rows(
        Kind.GAIT, states.stamp, states.stroke, states.frequency, states.direction, states.margin
    )
    gaits["onset"], gaits["state"], gaits["run"] = states.onset, states.state, states.run
    gaits["cycle"] = states.cycle
    tracker, power = run.tracker, run.power
    topics = [
        gaits,
        sample_rows(Kind.COMMAND, run.commanded.stamp, run.commanded.length_change),
        sample_rows(Kind.LENGTH, run.measured.stamp, run.measured.length),
        sample_rows(Kind.POSITION, tracker.stamp, tracker.rear_position, tracker.front_position),
        sample_rows(Kind.POWER, power.stamp, power.valid_power),
    ]
    rows = np.concatenate(topics)
    keys = [_arrival(topic["stamp"], jump_back_ns) for topic in topics]
    if received is not None:
        _jump_together(
            keys,
            [received.get(kind, topic["stamp"]) for kind, topic in zip(Kind, topics, strict=True)],
        )
    jumps, reached = (np.concatenate(part) for part in zip(*keys, strict=True))
    return rows[np.lexsort((reached, jumps))]


def _jump_together(
    keys: list[tuple[NDArray[np.int64], NDArray[np.int64]]], received: list[NDArray[np.int64]]
) -> None:
    """Lets topics that saw no jump of the clock themselves jump when the first of the others did."""
    most = max((int(jumps[-1]) for jumps, _ in keys if len(jumps)), default=0)
    for count in range(1, most + 1):
        began = [
            int(times[np.argmax(jumps >= count)])
            for (jumps, _), times in zip(keys, received, strict=True)
            if len(jumps) and jumps[-1] >= count
        ]
        for k, times in enumerate(received):
            jumps, reached = keys[k]
            if len(jumps) and jumps[-1] < count:
                keys[k] = np.where(times >= min(began), count, jumps), reached


def _arrival(
    stamp: NDArray[np.int64], jump_back_ns: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """(jumps of the clock before each sample of a topic, newest stamp of the topic by then)."""
    jumped = np.append(False, np.diff(stamp) < -jump_back_ns)[: len(stamp)]
    jumps = np.cumsum(jumped)
    reached = stamp.copy()
    borders = np.append(np.flatnonzero(np.append(True, jumped[1:])), len(stamp))[: len(stamp) + 1]
    for first, last in pairwise(borders.tolist()):
        reached[first:last] = np.maximum.accumulate(stamp[first:last])
    return jumps, reached
