# SPDX-License-Identifier: Apache-2.0
"""By how much a camera stamps too late: the tracker's ``delay_s``, as far as runs tell it.

The fit of the actuation tells by how much the length lags behind the command beyond what the body explains. Part of
that is the servo, which follows its goals; its encoder tells how late. The rest is the camera.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import least_squares

from worm_model.arrays import Array
from worm_model.identification.actuation_stage import ActuationResult
from worm_model.identification.estimate import Estimate, half_of_mean, not_told, quantile
from worm_model.identification.observed_run import Recording

LONGEST_LAG = 0.2  # s, of a servo that follows its goals
STAMPED = 3e-3  # s, to which a driver's stamps of goals and encoders are believed
NOTHING = "no run tells the camera's clock"
NO_ENCODER = (
    "the length lags by {:.1f} ms behind the command: the camera stamps so much too late, or the servo follows its "
    "goals so late; record body_length/cable to tell them apart"
)
PROPOSED = "add {:+.4f} s to delay_s in the tracker's setup file"
NONE_NEEDED = "delay_s of the tracker's setup file may stay as it is"


def camera_delay(recordings: Sequence[Recording], actuation: ActuationResult) -> Estimate:
    """The delay in s that is still in the camera's stamps, with what to do about it; of the mean over runs."""
    known = np.isfinite(actuation.clock_deviation)
    if not known.any():
        return not_told(float("nan"), NOTHING)
    late = -actuation.fit.clock_offset[known]
    lag = np.array([servo_lag(r) for r, t in zip(recordings, known, strict=True) if t])
    if not np.isfinite(lag).all():
        return not_told(float("nan"), NO_ENCODER.format(1e3 * late.mean()))
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
    """By how many s the servo's encoder is behind its goals; NaN where it was not recorded."""
    if not recording.cable.size:
        return float("nan")

    def misfit(lag: Array) -> Array:
        goal = np.interp(recording.cable_time - lag[0], recording.command_time, recording.command)
        return 1e3 * (recording.cable - goal)

    fit = least_squares(misfit, [0.0], bounds=(-LONGEST_LAG, LONGEST_LAG), loss="soft_l1")
    return float(fit.x[0])
