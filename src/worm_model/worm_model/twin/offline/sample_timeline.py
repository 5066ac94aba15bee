# SPDX-License-Identifier: Apache-2.0
"""A recording's samples as the twin takes them: admitted, by rising stamp, each with the time at which it is taken."""

from __future__ import annotations

import enum
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from worm_model.run import GaitStates, Run
from worm_model.twin.by_sample import gait_samples
from worm_model.twin.records import NANOSECONDS, Activity, GaitSample
from worm_model.twin.streams import FARTHEST_M, LONGEST_M, MOST_W
from worm_model.twin.twin_settings import TwinSettings

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]
Rows = NDArray[np.intp]
Mask = NDArray[np.bool_]


class Kind(enum.IntEnum):
    """Of a sample; of equal stamps the first of these goes first."""

    COMMAND = 0
    LENGTH = 1
    POSITION = 2
    POWER = 3


Columns = TypeVar("Columns")


def only(columns: Columns, chosen: Mask) -> Columns:
    """Some rows of a dataclass whose fields are all arrays of as many."""
    return type(columns)(*(values[chosen] for values in vars(columns).values()))


class Irregular(Exception):  # noqa: N818 - nobody's error
    """Something that only a twin that takes sample by sample can follow."""


@dataclass(frozen=True)
class Timeline:
    """Samples of all streams but the gait states, in the order in which the twin takes them, a row per sample.

    ``kind`` is a `Kind` each; ``value`` u_cmd in m, L in m, x1 in m (NaN: hidden) or W;
    ``front`` x2 in m (NaN: hidden, or no position); ``now`` the newest stamp heard when the sample is taken.
    ``gaits`` are the gait states, ``places`` the number of samples before each.
    """

    stamp: Stamps
    kind: NDArray[np.int64]
    value: Array
    front: Array
    now: Stamps
    gaits: tuple[GaitSample, ...]
    places: tuple[int, ...]


def read_timeline(run: Run, settings: TwinSettings) -> Timeline:
    """The samples of a recording that the twin takes; what it never comes to at the end is left out.

    Raises:
        Irregular: a pause in all streams, after which it would wait for streams to agree.
    """
    gaits = _gaits(run.gait_state)
    stamp, kind, value, front = _streams(run)
    pause = round(settings.hold_ahead_s * NANOSECONDS)
    told = np.array([sample.stamp_ns for sample in gaits], np.int64)
    if (np.diff(stamp) > pause).any() or (len(stamp) and (told > stamp[-1] + pause).any()):
        raise Irregular
    places = np.searchsorted(stamp, told, side="left")
    now = _taken_at(stamp, gaits, places, round(settings.start_hold_s * NANOSECONDS))
    known = now > 0  # the last ones may be held until the end
    return Timeline(
        stamp=stamp[known],
        kind=kind[known],
        value=value[known],
        front=front[known],
        now=now[known],
        gaits=gaits,
        places=tuple(np.minimum(places, np.count_nonzero(known)).tolist()),
    )


def _gaits(states: GaitStates) -> tuple[GaitSample, ...]:
    """By rising stamp, without duplicates."""
    found: list[GaitSample] = []
    for sample in sorted(gait_samples(states), key=lambda sample: sample.stamp_ns):
        if sample.stamp_ns > (found[-1].stamp_ns if found else 0):
            found.append(sample)
    return tuple(found)


def _streams(run: Run) -> tuple[Stamps, NDArray[np.int64], Array, Array]:
    """(stamp, kind, value, front) of what `worm_model.twin.streams` admits, by rising stamp."""
    command, length = run.commanded.length_change, run.measured.length
    rear, front = run.tracker.rear_position, run.tracker.front_position
    power = run.power.valid_power
    streams = (
        (run.commanded.stamp, command, np.abs(command) <= LONGEST_M),
        (run.measured.stamp, length, (length > 0.0) & (length <= LONGEST_M)),
        (run.tracker.stamp, rear, _is_seen(rear, front)),
        (run.power.stamp, power, np.abs(power) <= MOST_W),
    )
    stamps, kinds, values, fronts = [], [], [], []
    for number, (stamp, value, good) in enumerate(streams):
        rows = np.flatnonzero(good & (stamp > 0))
        found, first = np.unique(stamp[rows], return_index=True)  # of equal stamps the first counts
        stamps.append(found)
        kinds.append(np.full(len(found), number))
        values.append(value[rows[first]])
        fronts.append(
            front[rows[first]] if number == Kind.POSITION else np.full(len(found), np.nan)
        )
    stamp = np.concatenate(stamps)
    order = np.argsort(stamp, kind="stable")
    kind, value = np.concatenate(kinds), np.concatenate(values)
    return stamp[order], kind[order], value[order], np.concatenate(fronts)[order]


def _is_seen(rear: Array, front: Array) -> Mask:
    """Whether a tracker's sample has a position, and none that cannot be."""
    seen: Mask = (np.abs(rear) <= FARTHEST_M) | (np.abs(front) <= FARTHEST_M)
    return seen & ~((np.abs(rear) > FARTHEST_M) | (np.abs(front) > FARTHEST_M))


def _taken_at(stamp: Stamps, gaits: tuple[GaitSample, ...], places: Rows, hold: int) -> Stamps:
    """Newest stamp heard when each sample is taken; 0 for those that are held until the end."""
    now = stamp.copy()
    for first, last in resting_spans(gaits):
        ends = last < len(gaits)
        held = slice(places[first], places[last] if ends else len(stamp))
        released = np.searchsorted(stamp, stamp[held] + hold, side="left")
        until = np.append(stamp, 0)[released]
        if ends:
            over = gaits[last].stamp_ns
            until = np.where(until > 0, np.minimum(until, over), over)
        now[held] = until
    return now


def resting_spans(gaits: tuple[GaitSample, ...]) -> list[tuple[int, int]]:
    """First gait state of each rest, in which samples are held, and the one after its last."""
    spans: list[tuple[int, int]] = []
    for number, sample in enumerate(gaits):
        if sample.activity is not Activity.RESTING:
            continue
        if spans and spans[-1][1] == number:
            spans[-1] = spans[-1][0], number + 1
        else:
            spans.append((number, number + 1))
    return spans
