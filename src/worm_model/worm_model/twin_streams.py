# SPDX-License-Identifier: Apache-2.0
"""Which samples the twin takes: late, duplicate and missing ones, NaN, and a clock that jumps back.

Within a stream stamps ascend. A sample whose stamp is not after its stream's newest is a duplicate (equal)
or late (older): it is counted and left. Samples that are all older than the newest of any stream by more than
``jump_back_s``, three in a row, mean that the clock jumped (a bag that starts anew, a new time source): the
twin restarts. Whatever is not a number, or no length of a worm, is counted and left.
"""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass, field, replace

from worm_model.twin_records import (
    NANOSECONDS,
    CommandedLength,
    GaitSample,
    MeasuredLength,
    PowerSample,
    Sample,
    TrackerSample,
)

LONGEST_M = 1.0  # no worm is longer; a wrong unit would have the twin count millions of grooves
JUMP_CONFIRMATIONS = 3  # in a row: one wild stamp restarts nothing


class Verdict(enum.Enum):
    """What becomes of a sample."""

    TAKEN = "taken"
    DUPLICATE = "duplicate"
    LATE = "late"
    NOT_A_NUMBER = "not a number"
    JUMPED = "the clock jumped back"


@dataclass(frozen=True)
class Streams:
    """Newest stamp (ns) of each stream by the sample's type, and how often each verdict fell."""

    newest: dict[type, int] = field(default_factory=dict)
    counts: dict[Verdict, int] = field(default_factory=dict)
    old_in_a_row: int = 0

    @property
    def now_ns(self) -> int:
        """Newest stamp of all, 0 before the first."""
        return max(self.newest.values(), default=0)


def admit(streams: Streams, sample: Sample, jump_back_s: float) -> tuple[Streams, Verdict]:
    """(the streams after the sample, what becomes of it)."""
    verdict, old = _judge(streams, sample, jump_back_s)
    counts = {**streams.counts, verdict: streams.counts.get(verdict, 0) + 1}
    newest = streams.newest
    if verdict is Verdict.TAKEN:
        newest = {**newest, type(sample): sample.stamp_ns}
    return replace(streams, newest=newest, counts=counts, old_in_a_row=old), verdict


def _judge(streams: Streams, sample: Sample, jump_back_s: float) -> tuple[Verdict, int]:
    stamp = sample.stamp_ns
    if stamp <= 0 or not _is_number(sample):
        return Verdict.NOT_A_NUMBER, streams.old_in_a_row
    # A latched gait state may be as old as it likes: it speaks of the present.
    if isinstance(sample, GaitSample):
        last = streams.newest.get(GaitSample, 0)
        return (Verdict.DUPLICATE if stamp == last else Verdict.TAKEN), streams.old_in_a_row
    if streams.now_ns - stamp > jump_back_s * NANOSECONDS:
        old = streams.old_in_a_row + 1
        return (Verdict.JUMPED if old >= JUMP_CONFIRMATIONS else Verdict.LATE), old
    last = streams.newest.get(type(sample), 0)
    if stamp > last:
        return Verdict.TAKEN, 0
    return (Verdict.DUPLICATE if stamp == last else Verdict.LATE), 0


def _is_number(sample: Sample) -> bool:
    if isinstance(sample, CommandedLength):
        return abs(sample.length_change) <= LONGEST_M
    if isinstance(sample, MeasuredLength):
        return 0.0 < sample.length <= LONGEST_M
    if isinstance(sample, PowerSample):
        return math.isfinite(sample.power)
    if isinstance(sample, TrackerSample):
        return math.isfinite(sample.rear_position) or math.isfinite(sample.front_position)
    return True
