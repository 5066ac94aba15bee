# SPDX-License-Identifier: Apache-2.0
"""A recorded run's streams as the twin takes them, and its driving lengths, as columns (`worm_model.twin.offline`)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from worm_model.kernel.lag import follow_target
from worm_model.parameters import Parameters
from worm_model.run import Run
from worm_model.twin.records import NANOSECONDS
from worm_model.twin.settings import TwinSettings
from worm_model.twin.streams import LONGEST_M

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Signal:
    """Samples of a stream: stamps in ns, ascending, and finite values."""

    stamp: Stamps
    value: Array

    def since(self, stamp: int) -> Signal:
        """From a stamp (ns) on."""
        first = np.searchsorted(self.stamp, stamp)
        return Signal(self.stamp[first:], self.value[first:])

    def within(self, start: int, end: int) -> Iterator[tuple[int, float]]:
        """Stamps (ns) and values from a stamp up to another, this included."""
        first, last = np.searchsorted(self.stamp, start), np.searchsorted(self.stamp, end, "right")
        return zip(self.stamp[first:last].tolist(), self.value[first:last].tolist(), strict=True)


@dataclass(frozen=True)
class Estimates:
    """The length estimated from the command, at the onset and at the command's stamps: ΔL in m, its rate in m/s.

    `first` is the row of the first command: 0 if it came at the onset.
    """

    stamp: Stamps
    length_change: Array
    rate: Array
    first: int


@dataclass(frozen=True)
class Drive:
    """The lengths that drive the twin, from the onset on: ΔL in m; the rate of the estimate in m/s."""

    stamp: Stamps
    length_change: Array
    rate: Array
    measured: Mask


@dataclass(frozen=True)
class Inputs:
    """The streams as the twin takes them: u_cmd, L, x1 and x2 in m, power in W."""

    commands: Signal
    measured: Signal
    rear: Signal
    front: Signal
    power: Signal

    def since(self, stamp: int) -> Inputs:
        """From a stamp (ns) on."""
        return Inputs(*(getattr(self, row.name).since(stamp) for row in fields(self)))


def admit(run: Run) -> Inputs:
    """Only what `worm_model.twin.streams` admits, by rising stamp."""
    command, length = run.commanded.length_change, run.measured.length
    rear, front = run.tracker.rear_position, run.tracker.front_position
    return Inputs(
        commands=_signal(run.commanded.stamp, command, np.abs(command) <= LONGEST_M),
        measured=_signal(run.measured.stamp, length, (length > 0.0) & (length <= LONGEST_M)),
        rear=_signal(run.tracker.stamp, rear, np.isfinite(rear)),
        front=_signal(run.tracker.stamp, front, np.isfinite(front)),
        power=_signal(run.power.stamp, run.power.valid_power, np.isfinite(run.power.valid_power)),
    )


def _signal(stamp: Stamps, value: Array, good: Mask) -> Signal:
    """The good samples, of equal stamps the first."""
    found, first = np.unique(stamp[good], return_index=True)
    return Signal(found, value[good][first])


def estimate(commands: Signal, onset: int, parameters: Parameters) -> Estimates:
    """What the actuation model makes of the command, which leaves 0 at the onset, the slack taken up at once."""
    first = 0 if commands.stamp[0] == onset else 1
    stamp = np.concatenate([[onset], commands.stamp])[1 - first :]
    time = (stamp - onset) / NANOSECONDS
    command = np.concatenate([[0.0], commands.value])[1 - first :]
    above = command + parameters.slack
    crossing = np.flatnonzero(above[:-1] * above[1:] < 0.0)  # the clip is split where it opens
    share = above[crossing] / (above[crossing] - above[crossing + 1])
    at = time[crossing] + share * np.diff(time)[crossing]
    target = np.minimum(np.insert(command, crossing + 1, -parameters.slack), -parameters.slack)
    response = np.empty_like(target)
    times = np.insert(time, crossing + 1, at)
    follow_target(times, parameters.gain * target, parameters.time_constant, 0.0, response)
    kept = np.delete(np.arange(len(target)), crossing + 1 + np.arange(len(crossing)))
    # At the onset itself the length is still 0, and begins to follow the slack.
    rate = (parameters.gain * target - response)[kept] / parameters.time_constant
    return Estimates(stamp, response[kept], rate, first)


def driving_lengths(
    estimates: Estimates,
    lengths: Signal,
    since: int,
    initial_length: float,
    settings: TwinSettings,
) -> Drive:
    """The measured lengths, and the estimates where those are stale; the first is at the onset."""
    measured = lengths.since(since)
    last = int(lengths.stamp[lengths.stamp < since].max(initial=0))
    stale = round(settings.measured_stale_s * NANOSECONDS)
    known = np.concatenate([[last], measured.stamp])
    # Of a command and a measurement with the same stamp, the command comes first.
    gap = np.searchsorted(known, estimates.stamp[1:], side="left") - 1
    is_stale = estimates.stamp[1:] > known[gap] + stale
    chosen = np.concatenate([[True], np.isin(gap, gap[is_stale])])
    source = np.searchsorted(estimates.stamp, measured.stamp, side="right") - 1
    stamp = np.concatenate([estimates.stamp[chosen], measured.stamp])
    order = np.argsort(stamp, kind="stable")
    order = order[np.concatenate([[True], np.diff(stamp[order]) > 0])]
    return Drive(
        stamp=stamp[order],
        length_change=np.concatenate(
            [estimates.length_change[chosen], measured.value - initial_length]
        )[order],
        rate=np.concatenate([estimates.rate[chosen], estimates.rate[source]])[order],
        measured=(order >= chosen.sum()),
    )
