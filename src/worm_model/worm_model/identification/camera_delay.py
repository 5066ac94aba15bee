# SPDX-License-Identifier: Apache-2.0
"""Delay of the camera's stamps (the tracker's ``delay_s``), estimated from runs.

The measured length lags behind the command by more than the body's lag τ. The actuation fit estimates this additional
lag as the negative clock offset. It is the sum of two lags: that of the servo behind its goals, which the servo's
encoder shows, and the delay of the camera's stamps. A servo also yields to the cable force, which the body damps, so
that its encoder lags more than its goals explain. The gain and the time constant contain this yield; the lag does not.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import least_squares

from worm_model.arrays import Array
from worm_model.identification.actuation_stage import ActuationResult
from worm_model.identification.data.observed_run import Recording
from worm_model.identification.fits.actuation_fit import predicted_length_change
from worm_model.identification.fits.estimate import (
    Estimate,
    half_of_mean,
    not_identifiable,
    quantile,
)
from worm_model.parameters import Parameters

LONGEST_LAG = 0.2  # s, upper bound of a servo's lag
MOST_COMPLIANT = 1e-3  # m/N, upper bound of the yield of a servo per cable force
STAMPED = 3e-3  # s, assumed 95 % half-width of the error of the driver's stamps
NOTHING = "no run determines the camera's clock offset"
NO_ENCODER = (
    "the length lags {:.1f} ms behind the command. Either the camera's stamps are late or the servo lags behind its "
    "goals; record body_length/cable to separate the two"
)
PROPOSED = "add {:+.4f} s to delay_s in the tracker's setup file"
NONE_NEEDED = "delay_s in the tracker's setup file needs no change"


def camera_delay(
    recordings: Sequence[Recording], actuation: ActuationResult, body: Parameters
) -> Estimate:
    """Return the part of the delay (s) of the camera's stamps that ``delay_s`` does not correct yet.

    The mean is over the runs whose data determine the clock offset. The note proposes a correction. The result is not
    identifiable if there are no such runs, or if one of them has no encoder data. ``body`` are the identified
    parameters.
    """
    known = np.isfinite(actuation.clock_deviation)
    if not known.any():
        return not_identifiable(float("nan"), NOTHING)
    late = -actuation.fit.clock_offset[known]
    lag = np.array([servo_lag(r, body) for r, t in zip(recordings, known, strict=True) if t])
    if not np.isfinite(lag).all():
        return not_identifiable(float("nan"), NO_ENCODER.format(1e3 * late.mean()))
    delays = late - lag
    deviation = float(np.mean(actuation.clock_deviation[known])) / np.sqrt(delays.size)
    if delays.size > 1:
        half = max(half_of_mean(delays), quantile(delays.size - 1) * deviation)
    else:
        half = quantile(np.inf) * deviation
    half = float(np.hypot(half, STAMPED))
    mean = float(delays.mean())
    note = PROPOSED.format(mean) if abs(mean) > half else NONE_NEEDED
    return Estimate(mean, mean - half, mean + half, note=note)


def servo_lag(recording: Recording, body: Parameters) -> float:
    """Return the lag (s) of the servo's encoder behind the servo's goals; NaN if the encoder was not recorded.

    The encoder is behind the goals by the distance of the lag and by the compliance of the servo times the cable force
    (eq:Fc without inertia and friction). Both are fitted.
    """
    if not recording.cable.size:
        return float("nan")
    time, actuation = recording.cable_time, [body.slack, body.gain, body.time_constant]
    change = predicted_length_change(recording, np.array(actuation), time)
    compression = body.unstressed_length - body.initial_length - change
    force = body.bellows_stiffness * compression - body.bellows_damping * np.gradient(change, time)

    def misfit(values: Array) -> Array:
        goal = np.interp(time - values[0], recording.command_time, recording.command)
        return 1e3 * (recording.cable - goal - values[1] * force)

    bounds = ([-LONGEST_LAG, 0.0], [LONGEST_LAG, MOST_COMPLIANT])
    start, scale = [0.0, 1e-6], [1e-2, 1e-5]
    fit = least_squares(misfit, start, bounds=bounds, x_scale=scale, loss="soft_l1")
    return float(fit.x[0])
