# SPDX-License-Identifier: Apache-2.0
"""Stage 5: fit of slack δ_s, gain K and time constant τ to the measured ΔL (eq:actuation_identification_cost).

Each run also has nuisance parameters: its initial length L0, the offset between the clocks of camera and servo, and the
time at which the slack is taken up (at the first pull in the model, a little later on a robot). With a pretension, the
slack is already taken up at the onset.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from worm_model.arrays import Array
from worm_model.identification.data.observed_run import Recording
from worm_model.identification.fits.block_least_squares import Problem, Quantity, Solution, solve
from worm_model.identification.fits.estimate import noise_of
from worm_model.parameters import PAPER
from worm_model.simulation.actuation import resting_change
from worm_model.simulation.kernel.actuation_law import Actuator, respond_at, rest_of

INITIAL_LENGTH, CLOCK, ENGAGEMENT = range(3)  # entries of the nuisance parameters of a run
CLOCK_SPREAD = 0.02  # s, prior standard deviation of the clock offset (includes the servo's delay)
# The engagement is the time after the onset at which the slack is taken up, s.
LATEST_ENGAGEMENT = 0.25  # s, upper bound of the engagement
ENGAGEMENT_SPREAD = 0.05  # s, prior standard deviation of the engagement; the prior's centre is 0
LEAST_NOISE = 2e-5  # m, lower bound of the noise of a measured length
# Number of predictions that a problem keeps: those that differ only in L0 are equal, and so are those at the common
# start of several fits, each of which needs fewer
REMEMBERED = 2048
KEYS = ("slack", "gain", "time_constant")
START = (PAPER.slack, PAPER.gain, PAPER.time_constant)  # usual values, from which a fit starts
SHARED = (
    Quantity(1e-5, 0.0, 0.05),  # slack, m
    Quantity(1e-3, 0.05, 5.0),  # gain
    Quantity(1e-3, 1e-3, 3.0),  # time constant, s
)


@dataclass(frozen=True)
class ActuationFit:
    """An `actuation_problem` and its solution."""

    problem: Problem
    solution: Solution

    @property
    def values(self) -> Array:
        """Slack (m), gain (1) and time constant (s), shape (3,)."""
        return self.solution.shared

    @property
    def initial_length(self) -> Array:
        """L0 of each run, m, shape (runs,)."""
        return self.solution.own[:, INITIAL_LENGTH]

    @property
    def clock_offset(self) -> Array:
        """Offset of the camera's clock in each run, s, shape (runs,).

        Positive offsets mean early stamps: a sample with stamp t was measured at t + offset.
        """
        return self.solution.own[:, CLOCK]

    @property
    def engagement(self) -> Array:
        """Time after the onset at which the slack is taken up in each run, s, shape (runs,); 0 with a pretension."""
        return self.solution.own[:, ENGAGEMENT]


def predicted_length_change(
    recording: Recording,
    values: Array,
    times: Array,
    clock_offset: float = 0.0,
    engagement: float = 0.0,
) -> Array:
    """Return ΔL (m), shape (n,), that follows from a run's command.

    Args:
        recording: the run.
        values: δ_s in m, K, and τ in s, shape (3,).
        times: ascending times on the camera's clock, s, shape (n,).
        clock_offset: offset of the camera's clock, s, see `ActuationFit`.
        engagement: time after the onset until which ΔL has its value at rest, s. Ignored for a gait with pretension.
    """
    slack, gain, time_constant = map(float, values)
    actuator = Actuator(gain, slack, time_constant)
    pretension = recording.gait.pretension
    length_change = np.empty(len(times))
    respond_at(
        recording.command_time,
        recording.command,
        0.0 if pretension > 0.0 else engagement,
        rest_of(pretension, actuator),
        actuator,
        times + clock_offset,
        length_change,
    )
    return length_change


def fitted_samples(recording: Recording) -> NDArray[np.bool_]:
    """Return a mask of the camera samples to fit: both markers visible and the command known."""
    return np.isfinite(recording.length) & (recording.camera_time <= recording.command_time[-1])


def camera_noise(recording: Recording) -> float:
    """Return the standard deviation (m) of the noise of a measured length."""
    return max(noise_of(recording.length), LEAST_NOISE)


def actuation_problem(recordings: Sequence[Recording], known_noise: float = 0.0) -> Problem:
    """Return the least-squares problem of the measured lengths.

    Residuals are in units of the camera's noise, which is estimated from the data unless ``known_noise`` (m) is given.
    """
    samples = [fitted_samples(recording) for recording in recordings]
    times = [r.camera_time[kept] for r, kept in zip(recordings, samples, strict=True)]
    lengths = [r.length[kept] for r, kept in zip(recordings, samples, strict=True)]
    noise = [known_noise or camera_noise(recording) for recording in recordings]

    @lru_cache(REMEMBERED)
    def predicted(run: int, shared: bytes, clock_offset: float, engagement: float) -> Array:
        values = np.frombuffer(shared)
        return predicted_length_change(
            recordings[run], values, times[run], clock_offset, engagement
        )

    def residuals(run: int, shared: Array, own: Array) -> Array:
        change = predicted(run, shared.tobytes(), own[CLOCK], own[ENGAGEMENT])
        return (lengths[run] - own[INITIAL_LENGTH] - change) / noise[run]

    own = (
        Quantity(1e-4),  # initial length, m
        Quantity(1e-3, -0.1, 0.1, 0.0, CLOCK_SPREAD),
        Quantity(2e-3, 0.0, LATEST_ENGAGEMENT, 0.0, ENGAGEMENT_SPREAD),
    )
    return Problem(residuals, SHARED, [own for _ in recordings])


def slack_length(recording: Recording) -> float:
    """Return the start value of L0 (m): the length at rest minus ΔL of the paper's robot under the run's pretension."""
    return float(np.median(recording.length[recording.at_rest])) - resting_change(
        recording.gait, PAPER
    )


def fit_actuation(recordings: Sequence[Recording]) -> ActuationFit:
    """Fit slack, gain and time constant to all recordings, starting from the values of the paper."""
    own = np.array([[slack_length(r), 0.0, 0.0] for r in recordings])
    problem = actuation_problem(recordings)
    return ActuationFit(problem, solve(problem, np.array(START), own))
