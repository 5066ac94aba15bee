# SPDX-License-Identifier: Apache-2.0
"""A recording of several gaits, one after the other, cut into runs of one gait each."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from itertools import pairwise

import numpy as np

from worm_model.run import RUNNING, GaitStates, Run

_RESTING = 2  # GaitState.RESTING
_SAME_ONSET_NS = 100_000_000  # the driver tells the onset anew with each cycle
_REST_NS = 3_000_000_000  # before a gait whose rest was not announced
_SERIES = tuple(field.name for field in fields(Run) if field.name != "origin")


@dataclass(frozen=True)
class Part:
    """The run of one gait; it holds what has a stamp from ``start`` to before ``end`` (ns since the epoch)."""

    run: Run
    start: int
    end: int

    def holds(self, stamp: int) -> bool:
        """Whether a stamp lies in the part."""
        return self.start <= stamp < self.end


def parts_of(run: Run) -> list[Part]:
    """A part a gait that was played, in their order; each begins with the rest before its gait.

    A run of one gait or of none is its own only part.
    """
    onsets = _onsets(run.gait_state)
    bounds = [_rest_before(run.gait_state, *pair) for pair in pairwise(onsets)]
    limits = np.iinfo(np.int64)
    spans = pairwise([int(limits.min), *bounds, int(limits.max)])
    return [Part(_cut(run, *span) if bounds else run, *span) for span in spans]


def _onsets(states: GaitStates) -> list[int]:
    """Onset (ns) of each gait that was played."""
    told = np.unique(states.onset[(states.state == RUNNING) & (states.onset > 0)])
    first = np.diff(told, prepend=told[:1] - 2 * _SAME_ONSET_NS) > _SAME_ONSET_NS
    return [int(onset) for onset in told[first]]


def _rest_before(states: GaitStates, previous: int, onset: int) -> int:
    """When the rest began that leads to an onset."""
    rests = states.stamp[
        (states.state == _RESTING) & (states.stamp > previous) & (states.stamp <= onset)
    ]
    return int(rests[-1]) if rests.size else max(onset - _REST_NS, (previous + onset) // 2)


def _cut(run: Run, start: int, end: int) -> Run:
    cut, stamps = {}, []
    for name in _SERIES:
        series = getattr(run, name)
        rows = (series.stamp >= start) & (series.stamp < end)
        arrays = {
            field.name: getattr(series, field.name)[rows]
            for field in fields(series)
            if isinstance(getattr(series, field.name), np.ndarray)
        }
        cut[name] = replace(series, **arrays)
        stamps += arrays["stamp"][:1].tolist()
    return Run(origin=min(stamps, default=run.origin), **cut)
