# SPDX-License-Identifier: Apache-2.0
"""Contractions and extensions of a recorded run, between the turning points of the measured body length.

In a contraction the rear fin slides over the ridges and the front one holds; in an extension it is the other way round.
A run in reverse is the mirror image of one forward, so `motion_of` mirrors it.
"""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from worm_model.arrays import Array
from worm_model.gait import REVERSE, Gait
from worm_model.run import Run, seconds
from worm_model.simulation.smoothing import smooth

LENGTH_WINDOW_S = 0.06  # half window of the smoothed length; a jump of a module takes 0.1 s
TURNING_S = 0.22  # half window of the parabola through a turning point
_FEWEST_STEPS = 2.2  # between two samples, in the half window of a parabola
_SEARCH = (0.2, 0.35)  # of a period, before and after the command's turning point
# A robot differs from the templates of the fits by errors that successive samples share. So more samples per second do
# not show more.
_DISTINCT_HZ = 30.0
FEWEST_RATE_HZ = 8.0  # of the tracker; slower ones show no switch
# A position is wrong if it is farther from the median of five than a switch or the fastest module can bring it.
_JUMP_M, _FASTEST_M_PER_S = 0.005, 0.1


class Fin(enum.Enum):
    """Fin that slides: the rear one in a contraction, the front one in an extension."""

    REAR = "rear"
    FRONT = "front"


@dataclass(frozen=True)
class Motion:
    """Measured motion of a run in the direction of travel.

    Attributes:
        time: s since the onset, ascending, shape (n,).
        rear, front: positions of the modules, m, shape (n,).
        length: smoothed body length, m, shape (n,).
        noise: standard deviation of a position, m, of a camera with at most 30 Hz; a faster one with this standard
            deviation would show as much.
        end: end of the gait, s since the onset.
    """

    time: Array
    rear: Array
    front: Array
    length: Array
    noise: float
    end: float

    def holding(self, fin: Fin) -> Array:
        """Return the position of the holding module while ``fin`` slides, m, from the samples of both modules."""
        half = 0.5 * self.length
        return 0.5 * (self.rear + self.front) + (half if fin is Fin.REAR else -half)

    @cached_property
    def step(self) -> float:
        """Usual time between two samples, s."""
        return _step(self.time)

    @cached_property
    def turning(self) -> Array:
        """Length from parabolas through a turning point, m, at the times of the samples, shape (n,)."""
        half, _ = self.window(TURNING_S)
        return smooth(self.time, self.front - self.rear, self.time, half, half).value

    def window(self, half_window: float) -> tuple[float, float]:
        """Return a half window (s) with enough samples, and the standard deviation (m) of the length in its middle.

        It is that of a parabola through the samples of the window.
        """
        half = max(half_window, _FEWEST_STEPS * self.step)
        return half, 1.5 * math.sqrt(self.step / half) * self.noise

    def length_at(self, time: float | Array) -> Array:
        """Return the smoothed length at times in s, m."""
        return np.asarray(np.interp(time, self.time, self.length))


@dataclass(frozen=True)
class HalfCycle:
    """Contraction or extension: times (s since the onset) and lengths (m) of its turning points."""

    cycle: int
    fin: Fin
    start: float
    end: float
    start_length: float
    end_length: float

    @property
    def sign(self) -> int:
        """Sign of the change of the body length: −1 in a contraction, 1 in an extension."""
        return -1 if self.fin is Fin.REAR else 1

    @property
    def whole_travel(self) -> float:
        """Travel between the turning points, m."""
        return self.sign * (self.end_length - self.start_length)

    def travel(self, length: Array) -> Array:
        """Return the distance (m) by which the body has contracted, or extended, at a length."""
        return self.sign * (length - self.start_length)


def motion_of(run: Run, gait: Gait, onset: int, cycles: int) -> Motion | None:
    """Return the motion of a run's gait, or None if the tracker shows too little of both modules.

    Args:
        run: the recording.
        gait: its gait.
        onset: start of the gait, ns since the epoch.
        cycles: number of played cycles.
    """
    tracker = run.tracker
    time, end = seconds(tracker.stamp, onset), cycles * gait.period
    order = np.argsort(time, kind="stable")
    seen = np.isfinite(tracker.rear_position) & np.isfinite(tracker.front_position)
    used = order[seen[order] & (time[order] > -gait.period) & (time[order] < end + gait.period)]
    used = used[np.append(True, np.diff(time[used]) > 0.0)] if used.size else used
    used = used[_plausible(time[used], tracker.rear_position[used], tracker.front_position[used])]
    seen_in_gait = np.count_nonzero((time[used] > 0.0) & (time[used] < end))
    if cycles < 1 or seen_in_gait < FEWEST_RATE_HZ * end:
        return None
    time = time[used]
    rear, front = tracker.rear_position[used], tracker.front_position[used]
    if gait.direction == REVERSE:
        rear, front = -front, -rear
    step = _step(time)
    half = max(LENGTH_WINDOW_S, _FEWEST_STEPS * step)
    length = smooth(time, front - rear, time, half, half).value
    whole = np.isfinite(length)
    alike = max(1.0 / (_DISTINCT_HZ * step), 1.0)  # samples with the same error of the template
    noise = float(np.hypot(_noise(rear), _noise(front)) * np.sqrt(0.5 * alike))
    return Motion(time[whole], rear[whole], front[whole], length[whole], noise, end)


def _plausible(time: Array, *positions: Array) -> NDArray[np.bool_]:
    """Return False for each sample (n,) in which a position (n,) is an outlier, such as of confused markers."""
    largest = (
        max(_JUMP_M, _FASTEST_M_PER_S * float(np.median(np.diff(time)))) if time.size > 1 else 0.0
    )
    off = [np.abs(position - median_filter(position, 5)) for position in positions]
    return np.asarray(np.max(off, axis=0, initial=0.0) <= largest)


def half_cycles(motion: Motion, gait: Gait, cycles: int) -> list[HalfCycle]:
    """Return contraction and extension of each cycle, in order; a cycle that is not recorded to its end has none."""
    period, share = gait.period, gait.contraction_share
    found: list[HalfCycle] = []
    before = -0.2 * period
    for cycle in range(cycles):
        turn = (cycle + share) * period
        shortest = _turning_point(
            motion, turn - _SEARCH[0] * period, turn + _SEARCH[1] * period, 1, period
        )
        if shortest is None:
            break
        longest = _turning_point(motion, before, shortest[0], -1, period)
        following = _turning_point(motion, shortest[0], (cycle + 1.4) * period, -1, period)
        if longest is None or following is None:
            break
        found.append(
            HalfCycle(cycle + 1, Fin.REAR, longest[0], shortest[0], longest[1], shortest[1])
        )
        found.append(
            HalfCycle(cycle + 1, Fin.FRONT, shortest[0], following[0], shortest[1], following[1])
        )
        before = shortest[0]
    return found


def _turning_point(
    motion: Motion, low: float, high: float, sign: int, period: float
) -> tuple[float, float] | None:
    """Return (time, length) of the shortest (sign 1) or longest (−1) length between two times, or None."""
    inside = (motion.time >= low) & (motion.time <= min(high, motion.end + 0.6 * period))
    if np.count_nonzero(inside) < 4 or motion.time[-1] < low + 0.5 * (high - low):
        return None
    at, curve = motion.time[inside], motion.turning[inside]
    if not np.isfinite(curve).any():
        return None
    best = int(np.nanargmin(sign * curve))
    return float(at[best]), float(curve[best])


def _step(time: Array) -> float:
    return float(np.median(np.diff(time)))


def _noise(position: Array) -> float:
    """Return the standard deviation of the noise of a position from its second differences, m."""
    second = position[:-2] - 2.0 * position[1:-1] + position[2:]
    return max(float(1.4826 * np.median(np.abs(second)) / np.sqrt(6.0)), 2e-5)
