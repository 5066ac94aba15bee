# SPDX-License-Identifier: Apache-2.0
"""Division of recordings into the runs of single gaits."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from worm_model.run import Activity, GaitStates, Run

_REST_NS = 3_000_000_000  # assumed rest before a gait if no state RESTING was recorded
_SERIES = tuple(field.name for field in fields(Run) if field.name != "origin")


@dataclass(frozen=True)
class Part:
    """Part of a recording with one gait: the samples from ``start`` to before ``end`` (ns since the epoch)."""

    run: Run
    start: int
    end: int

    def holds(self, stamp: int) -> bool:
        """Return True if a stamp lies in the part."""
        return self.start <= stamp < self.end


def parts_of(run: Run) -> list[Part]:
    """Return one part for each played gait, in order. Each part begins with the rest before its gait.

    A recording with at most one gait has one part, which contains the whole recording.
    """
    states = run.gait_state
    onsets = [int(states.onset[rows].min()) for rows in states.rows_of_runs()]
    bounds = [_rest_before(states, *pair) for pair in pairwise(onsets)]
    limits = np.iinfo(np.int64)
    spans = pairwise([int(limits.min), *bounds, int(limits.max)])
    return [Part(_cut(run, *span) if bounds else run, *span) for span in spans]


def last_stamp(run: Run) -> int:
    """Return the greatest stamp (ns since the epoch) of a run, or its origin without samples."""
    stamps = [getattr(run, name).stamp for name in _SERIES]
    return int(max((stamp.max() for stamp in stamps if stamp.size), default=run.origin))


def _rest_before(states: GaitStates, previous: int, onset: int) -> int:
    """Return the stamp (ns) at which the rest between the onset of the previous gait and an onset (ns) began."""
    rests = states.stamp[
        (states.state == Activity.RESTING) & (states.stamp > previous) & (states.stamp <= onset)
    ]
    return int(rests[-1]) if rests.size else max(onset - _REST_NS, (previous + onset) // 2)


def _cut(run: Run, start: int, end: int) -> Run:
    cut, stamps = {}, []
    for name in _SERIES:
        series = getattr(run, name)
        cut[name] = _rows(series, (series.stamp >= start) & (series.stamp < end))
        stamps += cut[name].stamp[:1].tolist()
    return Run(origin=min(stamps, default=run.origin), **cut)


def _rows(series: Any, rows: NDArray[np.bool_]) -> Any:
    """Return the samples of a series for which ``rows`` (n,) is True."""
    columns = {field.name: getattr(series, field.name) for field in fields(series)}
    arrays = {name: col[rows] for name, col in columns.items() if isinstance(col, np.ndarray)}
    return replace(series, **arrays)
