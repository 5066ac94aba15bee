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
    """All samples that the twin takes, in the order in which they were ``received`` (ns, by `Kind`), as if live.

    Where that is not known of every topic that has samples: by stamp, each topic in its own order; where one goes back
    by more than ``jump_back_ns`` the clock has jumped, and all after that comes after all before.
    """
    states = run.gait_state
    gaits = sample_rows(
        Kind.GAIT, states.stamp, states.stroke, states.frequency, states.direction, states.margin
    )
    gaits["onset"], gaits["state"], gaits["run"] = states.onset, states.state, states.run
    gaits["cycle"] = states.cycle
    tracker, power = run.tracker, run.power
    topics = {
        Kind.GAIT: gaits,
        Kind.COMMAND: sample_rows(Kind.COMMAND, run.commanded.stamp, run.commanded.length_change),
        Kind.LENGTH: sample_rows(Kind.LENGTH, run.measured.stamp, run.measured.length),
        Kind.POSITION: sample_rows(
            Kind.POSITION, tracker.stamp, tracker.rear_position, tracker.front_position
        ),
        Kind.POWER: sample_rows(Kind.POWER, power.stamp, power.valid_power),
    }
    topics = {kind: topic for kind, topic in topics.items() if len(topic)}
    if not topics:
        return np.zeros(0, SAMPLE)
    keys = [_arrival(topic["stamp"], jump_back_ns) for topic in topics.values()]
    jumps, reached = (np.concatenate(part) for part in zip(*keys, strict=True))
    first = jumps
    if received is not None and all(kind in received for kind in topics):
        first = np.concatenate([received[kind] for kind in topics])
    return np.concatenate(list(topics.values()))[np.lexsort((reached, first))]


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
