# SPDX-License-Identifier: Apache-2.0
"""A cycle as the inference takes it: binned residuals with their variance, and what the tracker says of grooves.

The tracker settles grooves: the mean position residual over the cycle's last part, where nothing but a step shows,
tells by how much the robot is off. A step is taken out of the data; what it is, `worm_model.twin.diagnosis` decides.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from worm_model.arrays import Array
from worm_model.twin.core.memory import (
    CHANNELS,
    LENGTH_COUNT,
    LENGTH_SUM,
    PHASES,
    POSITION,
    POSITION_COUNT,
    POSITION_SUM,
    POWER,
    POWER_COUNT,
    POWER_SUM,
)
from worm_model.twin.signatures import BINS

WINDOW = 0.15  # of a cycle, at its end
STEADY_M = 0.001  # between both halves of that window, within which the robot is at rest
SLIPPING_M = 0.0045  # the same, within which a fin is about to slip
FEWEST = 3  # samples that make a mean
STEP_M = 0.0015  # off at the end of a cycle, beyond which something made a step
UNDERWAY = 0.15  # of a step, from which a position is on the way
LEAD = 4  # bins before a step's middle in which it may have begun

# What differs from cycle to cycle on a sound robot beside noise: m, m, W and of the power; first cycles more.
SCATTER = (0.0003, 0.0002, 0.04)
POWER_SHARE = 0.015
FIRST = (5.0, 2.0, 3.0)


@dataclass(frozen=True)
class Step:
    """The position's step in a cycle: by ``size`` m at the end, half of it reached at ``phase``; NaN: never.

    ``swift``: hardly any sample was seen on the way.
    """

    size: float
    phase: float = math.nan
    swift: bool = False

    @property
    def is_none(self) -> bool:
        """Whether the position came out as predicted."""
        return abs(self.size) <= STEP_M


@dataclass(frozen=True)
class CycleData:
    """Residuals (CHANNELS, BINS) without a step, and their variance, infinite where nothing was seen.

    ``watched``: a tracker saw the cycle's end; ``step`` is None where none did, or the step still went on; ``gained``
    whole grooves along the gait's direction that were settled by it.
    """

    number: int
    values: Array
    variance: Array
    step: Step | None
    watched: bool = False
    gained: int = 0


def cycle_data(
    number: int, sums: Array, noise: Array, power: Array, pitch: float, *, fresh: bool
) -> CycleData:
    """Of the sums (PHASES, SUMS) of a cycle; ``noise`` (CHANNELS,) of a sample; ``power`` (BINS,) in W as predicted.

    ``fresh`` is the first cycle of a motion, whose transient no two robots share.
    """
    by_bin = sums.reshape(BINS, PHASES // BINS, -1).sum(axis=1)
    total = by_bin[:, [POSITION_SUM, LENGTH_SUM, POWER_SUM]].T
    count = by_bin[:, [POSITION_COUNT, LENGTH_COUNT, POWER_COUNT]].T
    some = count > 0
    values = np.divide(total, count, out=np.zeros((CHANNELS, BINS)), where=some)
    scatter = np.tile(np.array(SCATTER)[:, None], BINS)
    scatter[POWER] += POWER_SHARE * power
    scatter *= np.array(FIRST)[:, None] if fresh else 1.0
    variance = np.full((CHANNELS, BINS), np.inf)
    np.divide(noise[:, None] ** 2, count, out=variance, where=some)
    variance += scatter**2
    watched = bool(sums[-round(WINDOW * PHASES) :, POSITION_COUNT].sum() >= FEWEST)
    step = _step(sums, values[POSITION], some[POSITION], pitch) if watched else None
    if step is None:
        variance[POSITION] = np.inf  # nobody knows what it has become
    elif not step.is_none:
        variance[POSITION, max(int(step.phase * BINS) - LEAD, 0) :] = np.inf
    return CycleData(number, values, variance, step, watched)


def _step(sums: Array, position: Array, some: NDArray[np.bool_], pitch: float) -> Step | None:
    """The step at the end of a cycle; where a fin is about to slip or has just caught itself, the half at rest."""
    half = round(0.5 * WINDOW * PHASES)
    means = [
        float(part[:, POSITION_SUM].sum() / part[:, POSITION_COUNT].sum())
        for part in (sums[-2 * half : -half], sums[-half:])
        if part[:, POSITION_COUNT].sum()
    ]
    apart = abs(means[-1] - means[0])
    size = float(np.mean(means))
    if apart > SLIPPING_M:  # a fin that catches itself just before the end
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
    """The step at the beginning of the bin from which it explains the positions best."""
    tracked = sums[:, POSITION_COUNT] > 0
    share = sums[tracked, POSITION_SUM] / sums[tracked, POSITION_COUNT] / size
    underway = int(np.sum(np.abs(share - 0.5) < 0.5 - UNDERWAY))
    after = (np.arange(BINS) >= np.arange(BINS)[:, None]).astype(float)
    misfit = np.sum(np.where(some, (position - size * after) ** 2, 0.0), axis=1)
    return Step(size, float(np.argmin(misfit)) / BINS, underway <= 1)
