# SPDX-License-Identifier: Apache-2.0
"""Loops over the samples of a recording in which each step depends on the one before (`worm_model.twin.offline`).

Stamps and spans are in integer nanoseconds; every array is a row per sample, in the order of processing.
"""

from __future__ import annotations

import math

import numpy as np

from worm_model.simulation.kernel.compiled import unlocked


@unlocked
def pick_due(stamp: np.ndarray, last: int, period: int, due: np.ndarray) -> None:
    """Fills ``due`` (n,) with whether a sample comes at least a period after the last one that was due."""
    for k in range(stamp.size):
        due[k] = stamp[k] - last >= period
        if due[k]:
            last = stamp[k]


@unlocked
def pick_settled(
    stamp: np.ndarray,
    waits: np.ndarray,
    newest: np.ndarray,
    half_window: int,
    step: int,
    settled: np.ndarray,
) -> None:
    """Fills ``settled`` (m,) with the last row whose power is final, once the row ``newest`` (m,) has been followed.

    A row that ``waits`` (n,) is final half a window later, any other at once; what is left of them is done
    in steps. Row 0 is final from the start.
    """
    first = 1
    for k in range(newest.size):
        limit = stamp[newest[k]] - half_window
        ready = first
        while ready <= newest[k] and not (waits[ready] and stamp[ready] > limit):
            ready += 1
        if ready > newest[k] or stamp[ready] - stamp[first] >= step:
            first = ready
        settled[k] = first - 1


@unlocked
def remember_residuals(
    channel: np.ndarray,
    stamp: np.ndarray,
    square: np.ndarray,
    forgets_before: np.ndarray,
    forgets_after: np.ndarray,
    spans: np.ndarray,
    newest: np.ndarray,
    mean: np.ndarray,
    size: np.ndarray,
) -> None:
    """Follows the mean square of each channel's residuals; see `worm_model.twin.residuals`.

    ``square`` (n,) of the residuals in units of their usual size, NaN where one does not count; before or
    after some samples channel 0 forgets. ``spans`` (2,): memory and silence in s. ``newest`` (c,) and
    ``mean`` (c,) are the channels before (stamp 0: unknown) and are left as they are afterwards; ``size``
    (n, c) gets the root of the means at each sample, NaN where a channel has no say.
    """
    memory, silence = spans
    for k in range(channel.size):
        if forgets_before[k]:
            newest[0] = 0
        c = channel[k]
        if not math.isnan(square[k]):
            if newest[c] == 0:
                newest[c], mean[c] = stamp[k], min(square[k], 1.0)
            else:
                elapsed = max(stamp[k] - newest[c], 0) * 1e-9
                share = math.exp(-elapsed / memory)
                mean[c] = share * mean[c] + (1.0 - share) * square[k]
                newest[c] = max(stamp[k], newest[c])
        if forgets_after[k]:
            newest[0] = 0
        for j in range(newest.size):
            heard = newest[j] != 0 and (stamp[k] - newest[j]) * 1e-9 <= silence
            size[k, j] = math.sqrt(mean[j]) if heard else math.nan
