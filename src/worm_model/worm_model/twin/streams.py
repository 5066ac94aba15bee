# SPDX-License-Identifier: Apache-2.0
"""Which samples the twin takes: late, duplicate and missing ones, NaN, and a clock that jumps.

- **Late, duplicate.** Within a stream stamps ascend. A sample whose stamp is not after its stream's newest is a
  duplicate (equal) or late (older): it is counted and left.
- **Jump back.** Samples that are all older than the newest of any stream by more than ``jump_back_s``, three in a
  row, mean that the clock jumped (a bag that starts anew, a new time source): the twin restarts.
- **Ahead.** A sample that is ahead of the newest of any stream by more than ``hold_ahead_s`` is held. Once three in
  a row agree, from two streams if two were alive, all of them are taken: after up to ``jump_ahead_s`` as
  the end of a pause, beyond as a clock that jumped ahead, with which the twin restarts. If a sample
  of the present comes before that, those held had wild stamps and are left.
- **Not a number**, or no length, position or power of a worm: counted and left.
"""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass, field, replace

from worm_model.twin.records import (
    NANOSECONDS,
    CommandedLength,
    GaitSample,
    MeasuredLength,
    PowerSample,
    Sample,
    TrackerSample,
)
from worm_model.twin.twin_settings import TwinSettings

LONGEST_M = 1.0  # no worm is longer; a wrong unit would have the twin count millions of grooves
FARTHEST_M = 1e5  # no tracker sees farther
MOST_W = 1e5  # no worm takes more
JUMP_CONFIRMATIONS = 3  # in a row: one wild stamp restarts nothing
PATIENCE = 100  # samples ahead in a row, which one stream alone may convince with


class Verdict(enum.Enum):
    """What becomes of a sample."""

    TAKEN = "taken"
    DUPLICATE = "duplicate"
    LATE = "late"
    AHEAD = "ahead"
    NOT_A_NUMBER = "not a number"
    JUMPED_BACK = "the clock jumped back"
    JUMPED_AHEAD = "the clock jumped ahead"


JUMPS = (Verdict.JUMPED_BACK, Verdict.JUMPED_AHEAD)


@dataclass(frozen=True)
class Streams:
    """Newest stamp (ns) of each stream by the sample's type, and how often each verdict fell.

    ``present_ns`` is the newest stamp of all but the gait states, which may be old when they are heard;
    ``old_in_a_row`` counts the last samples that were too old; ``ahead`` are those held.
    """

    newest: dict[type, int] = field(default_factory=dict)
    counts: dict[Verdict, int] = field(default_factory=dict)
    present_ns: int = 0
    old_in_a_row: int = 0
    ahead: tuple[Sample, ...] = ()

    @property
    def now_ns(self) -> int:
        """Newest stamp of all, 0 before the first."""
        return max(self.newest.values(), default=0)


def admit(
    streams: Streams, sample: Sample, settings: TwinSettings
) -> tuple[Streams, Verdict, tuple[Sample, ...]]:
    """(the streams after the sample, what becomes of it, the samples to be taken now)."""
    verdict = _judge(streams, sample, settings)
    if verdict is Verdict.TAKEN:
        return _taken(streams, sample), verdict, (sample,)
    streams = replace(streams, counts=_counted(streams.counts, verdict))
    if verdict is Verdict.AHEAD:
        return _hold(streams, sample, settings)
    if verdict is Verdict.NOT_A_NUMBER:
        return streams, verdict, ()
    if not _is_old(streams, sample, settings):
        return replace(streams, old_in_a_row=0, ahead=()), verdict, ()
    old = streams.old_in_a_row + 1
    if old < JUMP_CONFIRMATIONS:
        return replace(streams, old_in_a_row=old), verdict, ()
    return _restarted(streams, Verdict.JUMPED_BACK, (sample,))


def _judge(streams: Streams, sample: Sample, settings: TwinSettings) -> Verdict:
    stamp, present = sample.stamp_ns, streams.present_ns
    if stamp <= 0 or not _is_number(sample):
        return Verdict.NOT_A_NUMBER
    if present and stamp - present > settings.hold_ahead_s * NANOSECONDS:
        return Verdict.AHEAD
    last = streams.newest.get(type(sample), 0)
    if stamp == last:
        return Verdict.DUPLICATE
    # A latched gait state may be as old as it likes: it speaks of the present.
    if isinstance(sample, GaitSample):
        return Verdict.TAKEN
    too_old = stamp < last or _is_old(streams, sample, settings)
    return Verdict.LATE if too_old else Verdict.TAKEN


def _is_old(streams: Streams, sample: Sample, settings: TwinSettings) -> bool:
    return streams.now_ns - sample.stamp_ns > settings.jump_back_s * NANOSECONDS


def _taken(streams: Streams, sample: Sample) -> Streams:
    newest = {**streams.newest, type(sample): sample.stamp_ns}
    counts = _counted(streams.counts, Verdict.TAKEN)
    if isinstance(sample, GaitSample):
        return Streams(newest, counts, streams.present_ns, streams.old_in_a_row)
    return Streams(newest, counts, max(streams.present_ns, sample.stamp_ns))


def _hold(
    streams: Streams, sample: Sample, settings: TwinSettings
) -> tuple[Streams, Verdict, tuple[Sample, ...]]:
    """Holds a sample from ahead, or takes it with those before it that it agrees with."""
    near = sample.stamp_ns + round(settings.hold_ahead_s * NANOSECONDS)
    held = (*(other for other in streams.ahead if other.stamp_ns <= near), sample)
    alive = _alive(streams, settings)
    agreed = len(held) >= JUMP_CONFIRMATIONS and len(set(map(type, held))) >= min(alive, 2)
    if not agreed and len(held) < PATIENCE:
        return replace(streams, ahead=held), Verdict.AHEAD, ()
    if held[0].stamp_ns - streams.present_ns > settings.jump_ahead_s * NANOSECONDS:
        return _restarted(streams, Verdict.JUMPED_AHEAD, held)
    for other in held:
        streams = _taken(streams, other)
    return streams, Verdict.TAKEN, held


def _alive(streams: Streams, settings: TwinSettings) -> int:
    """Streams that had something to say of late."""
    limit = streams.present_ns - round(settings.hold_ahead_s * NANOSECONDS)
    return sum(stamp >= limit for kind, stamp in streams.newest.items() if kind is not GaitSample)


def _restarted(
    streams: Streams, verdict: Verdict, samples: tuple[Sample, ...]
) -> tuple[Streams, Verdict, tuple[Sample, ...]]:
    fresh = Streams(counts=_counted(streams.counts, verdict))
    for sample in samples:
        fresh = _taken(fresh, sample)
    return fresh, verdict, samples


def _counted(counts: dict[Verdict, int], verdict: Verdict) -> dict[Verdict, int]:
    return {**counts, verdict: counts.get(verdict, 0) + 1}


def _is_number(sample: Sample) -> bool:
    if isinstance(sample, CommandedLength):
        return abs(sample.length_change) <= LONGEST_M
    if isinstance(sample, MeasuredLength):
        return 0.0 < sample.length <= LONGEST_M
    if isinstance(sample, PowerSample):
        return abs(sample.power) <= MOST_W
    if isinstance(sample, TrackerSample):
        places = (sample.rear_position, sample.front_position)
        seen = [abs(place) <= FARTHEST_M for place in places if not math.isnan(place)]
        return bool(seen) and all(seen)
    return True
