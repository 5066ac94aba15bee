# SPDX-License-Identifier: Apache-2.0
"""Stage 5 as a whole: δ_s, K and τ with intervals from a bootstrap, over runs or, of few runs, over their cycles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from worm_model.identification.actuation import ActuationFit, fit_actuation, fitted_samples
from worm_model.identification.estimate import Estimate
from worm_model.identification.recording import Recording
from worm_model.identification.resampling import correlation, estimates, refitted, unit_weights

Array = NDArray[np.float64]

FEWEST_RUNS = 4  # for a bootstrap over runs


@dataclass(frozen=True)
class ActuationResult:
    """``slack`` m, ``gain``, ``time_constant`` s; ``correlation`` (3, 3) of these; ``fit`` has the nuisances."""

    slack: Estimate
    gain: Estimate
    time_constant: Estimate
    correlation: Array
    fit: ActuationFit


def identify_actuation(
    recordings: Sequence[Recording], random: np.random.Generator
) -> ActuationResult:
    """The three parameters of all runs."""
    fit = fit_actuation(recordings)
    labels = _units(recordings)
    units = int(max(label.max() for label in labels)) + 1
    weights = unit_weights(random, units)

    def refit(index: int) -> Array:
        drawn = [weights[index][label] for label in labels]
        return fit_actuation(recordings, fit, drawn).values

    refits = refitted(refit)
    slack, gain, time_constant = estimates(fit.values, refits, units)
    return ActuationResult(slack, gain, time_constant, correlation(refits), fit)


def _units(recordings: Sequence[Recording]) -> list[NDArray[np.int64]]:
    """For every sample that is fitted, the number of its unit: its run or its cycle."""
    times = [r.camera_time[fitted_samples(r)] for r in recordings]
    if len(recordings) >= FEWEST_RUNS:
        return [np.full(time.size, index) for index, time in enumerate(times)]
    labels, first = [], 0
    for recording, time in zip(recordings, times, strict=True):
        cycle = np.maximum(np.floor(time * recording.gait.frequency), 0.0).astype(np.int64)
        labels.append(first + cycle)
        first += int(cycle.max()) + 1
    return labels
