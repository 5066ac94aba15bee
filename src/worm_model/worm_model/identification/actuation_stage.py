# SPDX-License-Identifier: Apache-2.0
"""Stage 5 as a whole: δ_s, K and τ with intervals from a bootstrap, over runs or, of few runs, over their cycles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from worm_model.identification.actuation import ActuationFit, fit_actuation, fitted_samples
from worm_model.identification.estimate import Estimate, quantile
from worm_model.identification.recording import Recording
from worm_model.identification.resampling import correlation, estimates, refitted, unit_weights

Array = NDArray[np.float64]

FEWEST_RUNS = 4  # for a bootstrap over runs
LEAST_STEP = 1e-9  # m, that is no rounding of a computation
LEAST_FRACTION = 0.02  # of a step by which rounded commands may seem to differ from whole ones


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
    rounding = max(command_resolution(recording) for recording in recordings)
    slack = _widened(slack, quantile(np.inf) * rounding / np.sqrt(12.0))
    return ActuationResult(slack, gain, time_constant, correlation(refits), fit)


def command_resolution(recording: Recording) -> float:
    """Step in m in which the command was recorded; 0 if it was not rounded.

    Where a servo's goal is counted in ticks, its zero may be off by half of one, in every run alike.
    """
    steps = np.abs(np.diff(recording.command))
    steps = steps[steps > LEAST_STEP]
    if not steps.size:
        return 0.0
    least = float(steps.min())
    whole = np.abs(steps / least - np.rint(steps / least))
    return least if float(whole.max()) < LEAST_FRACTION else 0.0


def _widened(estimate: Estimate, half: float) -> Estimate:
    """The interval with an independent half-width added."""
    added = float(np.hypot(estimate.spread, half))
    return Estimate(estimate.value, estimate.value - added, estimate.value + added)


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
