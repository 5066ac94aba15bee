# SPDX-License-Identifier: Apache-2.0
"""Delay of the camera's stamps (the tracker's ``delay_s``), estimated from runs.

The measured length lags behind the command by more than the body's lag τ. The actuation fit estimates this additional
lag as the negative clock offset. It is the sum of two lags: that of the servo behind its goals, which the servo's
encoder shows, and the delay of the camera's stamps.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import least_squares

from worm_model.arrays import Array
from worm_model.identification.actuation_stage import ActuationResult
from worm_model.identification.data.observed_run import Recording
from worm_model.identification.fits.estimate import (
    Estimate,
    half_of_mean,
    not_identifiable,
    quantile,
)

LONGEST_LAG = 0.2  # s, upper bound of a servo's lag
STAMPED = 3e-3  # s, assumed 95 % half-width of the error of the driver's stamps
NOTHING = "no run determines the camera's clock offset"
NO_ENCODER = (
    "the length lags {:.1f} ms behind the command. Either the camera's stamps are late or the servo lags behind its "
    "goals; record body_length/cable to separate the two"
)
PROPOSED = "add {:+.4f} s to delay_s in the tracker's setup file"
NONE_NEEDED = "delay_s in the tracker's setup file needs no change"


def camera_delay(recordings: Sequence[Recording], actuation: ActuationResult) -> Estimate:
    """Return the part of the delay (s) of the camera's stamps that ``delay_s`` does not correct yet.

    The mean is over the runs whose data determine the clock offset. The note proposes a correction. The result is not
    identifiable if there are no such runs, or if one of them has no encoder data.
    """
    known = np.isfinite(actuation.clock_deviation)
    if not known.any():
        return not_identifiable(float("nan"), NOTHING)
    late = -actuation.fit.clock_offset[known]
    lag = np.array([servo_lag(r) for r, t in zip(recordings, known, strict=True) if t])
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


def servo_lag(recording: Recording) -> float:
    """Return the lag (s) of the servo's encoder behind the servo's goals; NaN if the encoder was not recorded."""
    if not recording.cable.size:
        return float("nan")

    def misfit(lag: Array) -> Array:
        goal = np.interp(recording.cable_time - lag[0], recording.command_time, recording.command)
        return 1e3 * (recording.cable - goal)

    fit = least_squares(misfit, [0.0], bounds=(-LONGEST_LAG, LONGEST_LAG), loss="soft_l1")
    return float(fit.x[0])
