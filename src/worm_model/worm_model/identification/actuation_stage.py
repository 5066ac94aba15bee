# SPDX-License-Identifier: Apache-2.0
"""Stage 5: slack δ_s, gain K and time constant τ, with intervals from a bootstrap over runs.

With fewer than `FEWEST_RUNS` runs, the bootstrap draws cycles instead of runs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from worm_model.arrays import Array
from worm_model.identification.data.observed_run import Recording
from worm_model.identification.fits import actuation_fit
from worm_model.identification.fits.block_least_squares import (
    normal_equations,
    solve,
)
from worm_model.identification.fits.estimate import (
    Estimate,
    if_identifiable,
    not_identifiable,
    quantile,
)
from worm_model.identification.fits.resampling import REFITS, correlation, estimates, unit_weights

# A parameter counts as without effect if a change of its value by one derivative step hardly changes the residuals: the
# sum of the squared changes, in units of the camera's noise, is below this limit.
LEAST_INFORMATION = 1e-9
NO_BEARING = "the parameter has no effect on these runs"
AT_BOUND = "the fit is at a bound, where no interval is valid"
FEWEST_RUNS = 4  # smallest number of runs for a bootstrap over runs
LEAST_STEP = 1e-9  # m; smaller changes between two samples of a command are rounding errors
# A command counts as quantised if all its changes are multiples of the smallest change. Each may deviate from a
# multiple by less than this share of the smallest change.
LEAST_FRACTION = 0.02


@dataclass(frozen=True)
class ActuationResult:
    """Result of stage 5.

    Attributes:
        slack, gain, time_constant: estimates, m, 1, s.
        correlation: correlation of the three estimates, shape (3, 3).
        fit: the fit to all runs, with the nuisance parameters.
    """

    slack: Estimate
    gain: Estimate
    time_constant: Estimate
    correlation: Array
    fit: actuation_fit.ActuationFit


def identify_actuation(
    recordings: Sequence[Recording], random: np.random.Generator
) -> ActuationResult:
    """Estimate slack, gain and time constant from all runs; ``random`` draws the bootstrap weights."""
    fit = actuation_fit.fit_actuation(recordings)
    labels = _units(recordings)
    units = int(max(label.max() for label in labels)) + 1
    weights = unit_weights(random, units)

    def refit(index: int) -> Array:
        drawn = [weights[index][label] for label in labels]
        return solve(fit.problem, fit.solution.shared, fit.solution.own, drawn).shared

    refits = np.array([refit(index) for index in range(REFITS)])
    # A run whose pretension takes up the slack contains no information about the slack.
    slack_units = sum(
        np.unique(label).size
        for recording, label in zip(recordings, labels, strict=True)
        if recording.gait.pretension < fit.values[0]
    )
    slack, gain, time_constant = estimates(fit.values, refits, (slack_units, units, units))
    rounding = max(command_resolution(recording) for recording in recordings)
    # The new half-width is the root of the sum of both squares, because the errors are independent.
    half = float(np.hypot(slack.spread, quantile(np.inf) * rounding / np.sqrt(12.0)))
    slack = Estimate(slack.value, slack.value - half, slack.value + half)
    matrix, _ = normal_equations(fit.problem, fit.solution)
    slack, gain, time_constant = (
        _checked(estimate, entry, float(matrix[entry, entry]))
        for entry, estimate in enumerate((slack, gain, time_constant))
    )
    return ActuationResult(slack, gain, time_constant, correlation(refits), fit)


def _checked(estimate: Estimate, entry: int, information: float) -> Estimate:
    """Return the estimate, marked as not identifiable if the runs do not determine it.

    This is the case if the parameter has no effect, if the fit is at a bound, or if the interval is too wide. ``entry``
    is the index of the parameter in `actuation_fit.SHARED`. ``information`` is the diagonal entry of the parameter in
    the matrix of the normal equations; its unit is the inverse square of the parameter's unit.
    """
    bounds = actuation_fit.SHARED[entry]
    if information * bounds.step**2 < LEAST_INFORMATION:
        return not_identifiable(estimate.value, NO_BEARING)
    if not bounds.low < estimate.value < bounds.high:
        return not_identifiable(estimate.value, AT_BOUND)
    return if_identifiable(estimate, actuation_fit.START[entry])


def command_resolution(recording: Recording) -> float:
    """Return the quantisation step of the recorded command in m; 0 if it was not quantised.

    A servo's goal is rounded to ticks, so that the command is a multiple of the length of a tick. The zero of the
    command therefore has an error of at most half a tick. This error is the same in all runs, so that a bootstrap over
    runs does not show it.
    """
    steps = np.abs(np.diff(recording.command))
    steps = steps[steps > LEAST_STEP]
    if not steps.size:
        return 0.0
    least = float(steps.min())
    whole = np.abs(steps / least - np.rint(steps / least))
    return least if float(whole.max()) < LEAST_FRACTION else 0.0


def _units(recordings: Sequence[Recording]) -> list[NDArray[np.int64]]:
    """Return for each recording the numbers of the bootstrap units of its fitted samples, shape (samples,).

    A unit is a run, or a cycle if there are fewer than `FEWEST_RUNS` runs.
    """
    times = [r.camera_time[actuation_fit.fitted_samples(r)] for r in recordings]
    if len(recordings) >= FEWEST_RUNS:
        return [np.full(time.size, index) for index, time in enumerate(times)]
    labels, first = [], 0
    for recording, time in zip(recordings, times, strict=True):
        cycle = np.maximum(np.floor(time * recording.gait.frequency), 0.0).astype(np.int64)
        labels.append(first + cycle)
        first += int(cycle.max()) + 1
    return labels
