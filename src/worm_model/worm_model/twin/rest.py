# SPDX-License-Identifier: Apache-2.0
"""The pose at rest from which a run starts, as the instruments saw it just before the onset."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from statistics import fmean

from worm_model.twin.records import NANOSECONDS, MeasuredLength, TrackerSample

FEWEST = 5  # samples that make a mean
GUARD_NS = (
    100_000_000  # before the onset; samples of that time may still be under way when the run begins
)
MARGIN_NS = NANOSECONDS  # kept beyond the span, since the onset is heard of late

Series = tuple[tuple[int, float], ...]


@dataclass(frozen=True)
class Rest:
    """Recent measured lengths, rear positions and distances of both modules in m, each with its stamp in ns."""

    lengths: Series = ()
    positions: Series = ()
    spans: Series = ()


@dataclass(frozen=True)
class RestPose:
    """Mean measured length L0 and mean rear position in m; NaN where samples are too few."""

    length: float
    position: float


def observe_rest(rest: Rest, sample: MeasuredLength | TrackerSample, span_s: float) -> Rest:
    """The recent past with a sample in it."""
    stamp = sample.stamp_ns
    if isinstance(sample, MeasuredLength):
        return replace(rest, lengths=_append(rest.lengths, stamp, sample.length, span_s))
    span = sample.front_position - sample.rear_position
    if math.isfinite(sample.rear_position):
        positions = _append(rest.positions, stamp, sample.rear_position, span_s)
        rest = replace(rest, positions=positions)
    if math.isfinite(span):
        rest = replace(rest, spans=_append(rest.spans, stamp, span, span_s))
    return rest


def rest_pose(rest: Rest, onset_ns: int, span_s: float) -> RestPose:
    """The means over a span (s) that ends shortly before the onset; without a measured length the tracker's."""
    last = onset_ns - GUARD_NS
    first = last - round(span_s * NANOSECONDS)
    length = _mean(rest.lengths, first, last)
    if math.isnan(length):
        length = _mean(rest.spans, first, last)
    return RestPose(length, _mean(rest.positions, first, last))


def _append(series: Series, stamp_ns: int, value: float, span_s: float) -> Series:
    oldest = stamp_ns - round(span_s * NANOSECONDS) - GUARD_NS - MARGIN_NS
    drop = 0
    while drop < len(series) and series[drop][0] < oldest:
        drop += 1
    return (*series[drop:], (stamp_ns, value))


def _mean(series: Series, first: int, last: int) -> float:
    values = [value for stamp, value in series if first <= stamp <= last]
    return fmean(values) if len(values) >= FEWEST else math.nan
