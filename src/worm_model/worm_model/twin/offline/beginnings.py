# SPDX-License-Identifier: Apache-2.0
"""Where runs begin and end in a recording, as the twin hears of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from worm_model.gait import Gait
from worm_model.twin.offline.sample_timeline import Irregular, Kind, Timeline, resting_spans
from worm_model.twin.records import NANOSECONDS
from worm_model.twin.run_start import MOVED, PLAYING, SAME_RUN_NS
from worm_model.twin.twin_settings import TwinSettings


@dataclass(frozen=True)
class Beginning:
    """The first word of a run: heard at ``heard_ns`` as gait state ``number`` (−1: none), after ``place`` samples.

    ``gait`` is None and ``onset_ns`` the stamp of the command before where only a command told.
    """

    number: int
    place: int
    heard_ns: int
    onset_ns: int
    gait: Gait | None


@dataclass(frozen=True)
class Stretch:
    """Samples ``first`` to ``last`` (exclusive): those before the first run, or of a run and the time after it.

    ``begins`` is the first word of the run (None: before the first), ``end_ns`` the stamp of the first word that it
    is over (0: none), ``end`` the number of samples before that word.
    """

    begins: Beginning | None
    first: int
    last: int
    end_ns: int = 0
    end: int = 0


def cut(timeline: Timeline, settings: TwinSettings) -> list[Stretch]:
    """The stretches of a recording, the first of them before any run.

    Raises:
        Irregular: a gait that cannot be, a run that is over before it begins, or begins before the one before it.
    """
    begins = [*_unannounced(timeline), *_announced(timeline, settings)]
    borders = [0, *np.maximum.accumulate([0, *(b.place for b in begins)])[1:].tolist()]
    borders.append(len(timeline.stamp))
    found = [Stretch(None, borders[0], borders[1])]
    for k, begin in enumerate(begins):
        first, last = borders[k + 1 : k + 3]
        following = begins[k + 1].number if k + 1 < len(begins) else len(timeline.gaits)
        later = range(begin.number + 1, following)
        over = [n for n in later if timeline.gaits[n].activity not in PLAYING]
        end_ns = timeline.gaits[over[0]].stamp_ns if over else 0
        end = timeline.places[over[0]] if over else last
        if 0 < end_ns < begin.onset_ns:
            raise Irregular
        found.append(Stretch(begin, first, last, end_ns, end))
    return found


def _unannounced(timeline: Timeline) -> list[Beginning]:
    """Before any gait state, a command that leaves 0 begins a run at the command before."""
    unheard = timeline.places[0] if timeline.places else len(timeline.stamp)
    commands = np.flatnonzero(timeline.kind[:unheard] == Kind.COMMAND)
    moved = np.flatnonzero(timeline.value[commands] < -MOVED)
    if not len(moved):
        return []
    place, before = commands[moved[0]], commands[max(moved[0] - 1, 0)]
    heard, onset = int(timeline.stamp[place]), int(timeline.stamp[before])
    return [Beginning(-1, int(place), heard, onset, None)]


def _announced(timeline: Timeline, settings: TwinSettings) -> list[Beginning]:
    """The gait states that begin a run."""
    onset, begins = 0, []
    for number, sample in enumerate(timeline.gaits):
        if sample.activity not in PLAYING or sample.onset_ns <= 0:
            continue
        if onset and abs(sample.onset_ns - onset) <= SAME_RUN_NS:
            continue
        if sample.gait is None or sample.onset_ns < onset:
            raise Irregular
        onset, place = sample.onset_ns, _first_sample(timeline, number, settings)
        begins.append(Beginning(number, place, sample.stamp_ns, onset, sample.gait))
    return begins


def _first_sample(timeline: Timeline, number: int, settings: TwinSettings) -> int:
    """Number of samples that were taken before a run that a gait state began; those held go up to its onset."""
    place = timeline.places[number]
    rested_from = [first for first, last in resting_spans(timeline.gaits) if last == number]
    if not rested_from or not place:
        return place
    heard = int(timeline.stamp[place - 1])
    released = heard - round(settings.start_hold_s * NANOSECONDS)
    held_up_to = [timeline.gaits[number].onset_ns, released]
    taken = np.searchsorted(timeline.stamp, held_up_to, side="right")
    return min(place, max(int(taken.max()), timeline.places[rested_from[0]]))
