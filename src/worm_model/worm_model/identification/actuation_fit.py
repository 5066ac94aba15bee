# SPDX-License-Identifier: Apache-2.0
"""Stage 5: slack δ_s, gain K and time constant τ from commanded against realised ΔL (eq:actuation_identification_cost).

Beside the three, each run has nuisances: its initial length L0, by how much the camera's clock is off the
servo's, and when the slack was taken up (at the first pull in the model, a little later on a robot).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from worm_model.arrays import Array
from worm_model.identification.block_least_squares import Problem, Quantity, Solution, solve
from worm_model.identification.observed_run import Recording
from worm_model.identification.robust import noise_of
from worm_model.simulation.kernel.actuation_law import Actuator, respond_at

CLOCK_SPREAD = 0.02  # s, standard deviation of the offset before the data are seen: clocks, and the servo's delay
LATEST_ENGAGEMENT = 0.25  # s after the onset
ENGAGEMENT_SPREAD = 0.05  # s
LEAST_NOISE = 2e-5  # m, of a length: that of a perfect camera
KEYS = ("slack", "gain", "time_constant")
START = (0.008, 0.86, 0.155)  # the paper's
SHARED = (
    Quantity(1e-5, 0.0, 0.05),  # slack, m
    Quantity(1e-3, 0.05, 5.0),  # gain
    Quantity(1e-3, 1e-3, 3.0),  # time constant, s
)


@dataclass(frozen=True)
class ActuationFit:
    """``slack`` m, ``gain``, ``time_constant`` s, and the nuisances of each run.

    ``initial_length`` m, ``clock_offset`` s and ``engagement`` s, each (runs,); ``residuals`` of each run in m.

    A positive clock offset means that the camera's stamps are early: a sample stamped t was taken at t + offset.
    """

    slack: float
    gain: float
    time_constant: float
    initial_length: Array
    clock_offset: Array
    engagement: Array
    residuals: tuple[Array, ...]
    solution: Solution

    @property
    def values(self) -> Array:
        """(slack, gain, time constant)."""
        return np.array([getattr(self, key) for key in KEYS])


def predicted_length_change(
    recording: Recording,
    values: Array,
    times: Array,
    clock_offset: float = 0.0,
    engagement: float = 0.0,
) -> Array:
    """ΔL in m at the camera's ``times`` (n,) in s, ascending, under (δ_s, K, τ); 0 before the engagement (s)."""
    slack, gain, time_constant = map(float, values)
    length_change = np.empty(len(times))
    respond_at(
        recording.command_time,
        recording.command,
        engagement,
        0.0,
        Actuator(gain, slack, time_constant),
        times + clock_offset,
        length_change,
    )
    return length_change


def fitted_samples(recording: Recording) -> NDArray[np.bool_]:
    """Which camera samples count: both markers seen, while commands are known."""
    return np.isfinite(recording.length) & (recording.camera_time <= recording.command_time[-1])


def actuation_problem(recordings: Sequence[Recording], known_noise: float = 0.0) -> Problem:
    """Residuals of the measured lengths in units of the camera's noise, which the data tell unless it is known (m)."""
    samples = [fitted_samples(recording) for recording in recordings]
    noise = [known_noise or max(noise_of(r.length), LEAST_NOISE) for r in recordings]

    def residuals(run: int, shared: Array, own: Array) -> Array:
        recording, kept = recordings[run], samples[run]
        predicted = predicted_length_change(
            recording, shared, recording.camera_time[kept], own[1], own[2]
        )
        return (recording.length[kept] - own[0] - predicted) / noise[run]

    own = (
        Quantity(1e-4),  # initial length, m
        Quantity(1e-3, -0.1, 0.1, 0.0, CLOCK_SPREAD),
        Quantity(2e-3, 0.0, LATEST_ENGAGEMENT, 0.0, ENGAGEMENT_SPREAD),
    )
    return Problem(residuals, SHARED, [own for _ in recordings])


def fit_actuation(
    recordings: Sequence[Recording],
    start: ActuationFit | None = None,
    weights: Sequence[Array] | None = None,
) -> ActuationFit:
    """Fits the three parameters to all recordings at once, by default from the paper's values.

    ``weights`` are those of every run's `fitted_samples`.
    """
    if start is None:
        shared = np.array(START)
        own = np.array([[float(np.median(r.length[r.at_rest])), 0.0, 0.0] for r in recordings])
    else:
        shared, own = start.solution.shared, start.solution.own
    solution = solve(actuation_problem(recordings), shared, own, weights)
    noise = [max(noise_of(r.length), LEAST_NOISE) for r in recordings]
    slack, gain, time_constant = map(float, solution.shared)
    return ActuationFit(
        slack,
        gain,
        time_constant,
        initial_length=solution.own[:, 0],
        clock_offset=solution.own[:, 1],
        engagement=solution.own[:, 2],
        residuals=tuple(r * n for r, n in zip(solution.residuals, noise, strict=True)),
        solution=solution,
    )
