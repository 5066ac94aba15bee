# SPDX-License-Identifier: Apache-2.0
"""Data of one cycle for the inference: binned residuals, their variance, and the step of the position.

A step is a lasting change of the position residual that begins in a cycle, for example because of a missed groove. Its
size is the mean position residual in the last part of the cycle. `without_step` excludes the positions from the step
on. `worm_model.twin.diagnosis` finds the cause of the step.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from worm_model.arrays import Array
from worm_model.twin.core import memory
from worm_model.twin.signatures import BINS

WINDOW = 0.15  # last part of a cycle, in which the step is measured
STEADY_M = 0.001  # largest difference between the mean residuals of both halves of the window
SLIPPING_M = 0.0045  # largest such difference if a fin is about to slip or has just slipped
FEWEST = 3  # smallest number of positions in the window
STEP_M = 0.0015  # residual at the end of a cycle above which there is a step
UNDERWAY = 0.15  # a position is on the way between the shares UNDERWAY and 1 − UNDERWAY of a step
MISFIT = 1.5  # model error, relative to that of a healthy robot, of a robot that the parameters do not describe
LEAD = 4  # number of bins before the phase of a step in which the step may have begun

# Standard deviation of the residuals of a healthy robot in addition to noise, by channel: m, m, W. POWER_SHARE times
# the predicted power is added to the third. In the first remembered cycle, FIRST multiplies these values.
SCATTER = (0.0003, 0.0002, 0.04)
POWER_SHARE = 0.015
FIRST = (5.0, 2.0, 3.0)


@dataclass(frozen=True)
class Step:
    """Step of the position residual in a cycle.

    Attributes:
        size: step at the end of the cycle, m.
        phase: phase of the cycle at which an instantaneous step best explains the positions; NaN without a step.
        swift: True if at most one of the PHASES bins has a position on the way, see `UNDERWAY`.
    """

    size: float
    phase: float = math.nan
    swift: bool = False

    @property
    def is_none(self) -> bool:
        """True if the position agrees with the prediction."""
        return abs(self.size) <= STEP_M


@dataclass(frozen=True)
class CycleData:
    """Residuals of a cycle, and the step in it.

    Attributes:
        number: number of the cycle.
        values: mean residuals, shape (CHANNELS, BINS).
        variance: their variances, infinite without data, shape (CHANNELS, BINS).
        step: the step, of size ≈ 0 if the position agrees; None without a tracker, or while a step is in progress.
        watched: True if a tracker saw the end of the cycle.
        gained: whole grooves of the step along the gait's direction.
        predicted: grooves that the twin gained in the cycle, along the gait's direction.
        error: model error of each channel, relative to that of a healthy robot, see `causes.model_error`.
        fewer, more: probabilities that a healthy robot near an edge gains one groove less or more than predicted.
    """

    number: int
    values: Array
    variance: Array
    step: Step | None
    watched: bool = False
    gained: int = 0
    predicted: int = 0
    error: tuple[float, ...] = (1.0,) * memory.CHANNELS
    fewer: float = 0.0
    more: float = 0.0

    @property
    def is_misfit(self) -> bool:
        """True if the parameters do not describe the robot."""
        return max(self.error) >= MISFIT

    def at_edge(self, gained: int) -> float:
        """Return the probability that a healthy robot near an edge gains other grooves than predicted, by number."""
        return {-1: self.fewer, 1: self.more}.get(gained, 0.0)


def cycle_data(
    number: int, sums: Array, noise: Array, power: Array, pitch: float, *, fresh: bool
) -> CycleData:
    """Return the data of a cycle, including the positions from its step on.

    Args:
        number: number of the cycle.
        sums: sums of the cycle's residuals, shape (PHASES, SUMS).
        noise: standard deviation of the noise of a sample, in the channel's unit, shape (CHANNELS,).
        power: predicted power, W, shape (BINS,).
        pitch: distance between two grooves, m.
        fresh: True for the first remembered cycle, whose transient differs between robots.
    """
    by_bin = sums.reshape(BINS, memory.PHASES // BINS, -1).sum(axis=1)
    total = by_bin[:, [memory.POSITION_SUM, memory.LENGTH_SUM, memory.POWER_SUM]].T
    count = by_bin[:, [memory.POSITION_COUNT, memory.LENGTH_COUNT, memory.POWER_COUNT]].T
    some = count > 0
    values = np.divide(total, count, out=np.zeros((memory.CHANNELS, BINS)), where=some)
    scatter = np.tile(np.array(SCATTER)[:, None], BINS)
    scatter[memory.POWER] += POWER_SHARE * power
    scatter *= np.array(FIRST)[:, None] if fresh else 1.0
    variance = np.full((memory.CHANNELS, BINS), np.inf)
    np.divide(noise[:, None] ** 2, count, out=variance, where=some)
    variance += scatter**2
    watched = bool(sums[-round(WINDOW * memory.PHASES) :, memory.POSITION_COUNT].sum() >= FEWEST)
    step = _step(sums, values[memory.POSITION], some[memory.POSITION], pitch) if watched else None
    return CycleData(number, values, variance, step, watched)


def without_step(data: CycleData) -> CycleData:
    """Return the data of a cycle without the positions from its step on, or without positions if the step is None."""
    if data.step is not None and data.step.is_none:
        return data
    first = 0 if data.step is None else max(int(data.step.phase * BINS) - LEAD, 0)
    variance = data.variance.copy()
    variance[memory.POSITION, first:] = np.inf
    return replace(data, variance=variance)


def _step(sums: Array, position: Array, some: NDArray[np.bool_], pitch: float) -> Step | None:
    """Return the step at the end of a cycle, or None while it is in progress.

    If a fin is about to slip or has just slipped, only the half of the window counts whose mean is nearer to a whole
    number of grooves.
    """
    half = round(0.5 * WINDOW * memory.PHASES)
    means = [
        float(part[:, memory.POSITION_SUM].sum() / part[:, memory.POSITION_COUNT].sum())
        for part in (sums[-2 * half : -half], sums[-half:])
        if part[:, memory.POSITION_COUNT].sum()
    ]
    apart = abs(means[-1] - means[0])
    size = float(np.mean(means))
    if apart > SLIPPING_M:  # the step is within the window; only the last bin may be after it
        size = float(position[-1])
        if not some[-1] or round(size / pitch) == 0 or abs(_off_whole(size, pitch)) > STEADY_M:
            return None
    elif apart > STEADY_M:
        size = min(means, key=lambda mean: abs(_off_whole(mean, pitch)))
    step = Step(size)
    return step if step.is_none else _located(sums, position, some, step.size)


def _off_whole(size: float, pitch: float) -> float:
    return size - round(size / pitch) * pitch


def _located(sums: Array, position: Array, some: NDArray[np.bool_], size: float) -> Step:
    """Return a step of a given size (m), which begins with the bin from which it best explains the positions."""
    tracked = sums[:, memory.POSITION_COUNT] > 0
    share = sums[tracked, memory.POSITION_SUM] / sums[tracked, memory.POSITION_COUNT] / size
    underway = int(np.sum(np.abs(share - 0.5) < 0.5 - UNDERWAY))
    after = (np.arange(BINS) >= np.arange(BINS)[:, None]).astype(float)
    misfit = np.sum(np.where(some, (position - size * after) ** 2, 0.0), axis=1)
    return Step(size, float(np.argmin(misfit)) / BINS, underway <= 1)
