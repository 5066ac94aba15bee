# SPDX-License-Identifier: Apache-2.0
"""Predicted margin of a gait: the increase of the switching threshold after which the model loses a groove."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, replace

import numpy as np
from numpy.typing import NDArray

from worm_model.arrays import Array
from worm_model.gait import Gait
from worm_model.parameters import Parameters
from worm_model.simulation.batch import branch_of, evaluate_gaits

MOST_MARGIN = 2e-2  # end of the scan, m
_STEP = 2.5e-4  # of the scan, m
_BISECTIONS = 10  # of a step of the scan


def predicted_margin(gait: Gait, parameters: Parameters, grooves: int) -> float:
    """Return the largest increase of the switching threshold (m) with which the model gains the grooves.

    It is negative if the model needs a smaller threshold, and refers to the fin that loses its groove first. The result
    is comparable with the smaller of the measured margins of both fins.

    Args:
        gait: gait; its margin has no effect.
        parameters: parameters of the robot.
        grooves: grooves per cycle that the gait is to gain.
    """
    p, unmargined = parameters, asdict(replace(gait, margin=0.0))
    least = 0.51 * max(p.pitch, p.clearance) - p.switching_threshold

    def kept(margins: Array) -> NDArray[np.bool_]:
        thresholds = {"switching_threshold": p.switching_threshold + margins}
        table = evaluate_gaits(**unmargined, parameters=p, overrides=thresholds)
        return np.asarray(branch_of(table) >= grooves)

    return float(largest_margins(kept, 1, least)[0])


def largest_margins(
    kept: Callable[[Array], NDArray[np.bool_]], count: int, least: float = 0.0
) -> Array:
    """Return the largest margin (m) up to which each of several gaits keeps its grooves, shape (count,).

    Args:
        kept: returns for margins (count, k) where the gaits keep their grooves, shape (count, k).
        count: number of gaits.
        least: smallest margin, m; the result for a gait that does not keep its grooves even with it.
    """
    scanned = np.arange(least, MOST_MARGIN, _STEP)
    lost = np.argmin(
        np.column_stack([kept(np.tile(scanned, (count, 1))), np.zeros(count, dtype=bool)]), axis=1
    )
    low = scanned[np.maximum(lost - 1, 0)]
    high = low + np.where(lost > 0, _STEP, 0.0)
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        stays = kept(middle[:, np.newaxis])[:, 0]
        low, high = np.where(stays, middle, low), np.where(stays, high, middle)
    return low
