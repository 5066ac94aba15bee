# SPDX-License-Identifier: Apache-2.0
"""Stage 5 as a whole: δ_s, K and τ with intervals from a bootstrap, over runs or, of few runs, over their cycles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from worm_model.arrays import Array
from worm_model.identification.actuation_fit import (
    CLOCK_SPREAD,
    SHARED,
    ActuationFit,
    actuation_problem,
    fit_actuation,
    fitted_samples,
)
from worm_model.identification.block_least_squares import clock_deviations, normal_equations, told
from worm_model.identification.estimate import Estimate, if_told, not_told, quantile
from worm_model.identification.observed_run import Recording
from worm_model.identification.resampling import correlation, estimates, refitted, unit_weights
from worm_model.parameters import PAPER

USUAL = (PAPER.slack, PAPER.gain, PAPER.time_constant)
CLOCK = 1  # of a run's nuisances
LEAST_INFORMATION = 1e-9  # of a parameter's step, in squares of the camera's noise
NO_BEARING = "it has no bearing on these runs"
AT_BOUND = "the fit stands at the edge of what it may be, where no interval holds"
FEWEST_RUNS = 4  # for a bootstrap over runs
LEAST_STEP = 1e-9  # m, that is no rounding of a computation
LEAST_FRACTION = 0.02  # of a step by which rounded commands may seem to differ from whole ones


@dataclass(frozen=True)
class ActuationResult:
    """``slack`` m, ``gain``, ``time_constant`` s; ``correlation`` (3, 3) of these; ``fit`` has the nuisances.

    ``clock_deviation`` (runs,) s, of the fit's clock offsets, NaN where the data tell none.
    """

    slack: Estimate
    gain: Estimate
    time_constant: Estimate
    correlation: Array
    fit: ActuationFit
    clock_deviation: Array


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
    problem = actuation_problem(recordings)
    matrix, _ = normal_equations(problem, fit.solution)
    slack, gain, time_constant = (
        _told(estimate, entry, float(matrix[entry, entry]))
        for entry, estimate in enumerate((slack, gain, time_constant))
    )
    clocks = told(clock_deviations(problem, fit.solution, CLOCK), CLOCK_SPREAD)
    return ActuationResult(slack, gain, time_constant, correlation(refits), fit, clocks)


def _told(estimate: Estimate, entry: int, information: float) -> Estimate:
    """The estimate unless its interval is open, it has no ``information``, or it is at a bound of the bootstrap."""
    bounds = SHARED[entry]
    if information * bounds.step**2 < LEAST_INFORMATION:
        return not_told(estimate.value, NO_BEARING)
    if not bounds.low < estimate.value < bounds.high:
        return not_told(estimate.value, AT_BOUND)
    return if_told(estimate, USUAL[entry])


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
