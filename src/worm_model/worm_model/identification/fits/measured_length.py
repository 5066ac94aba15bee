# SPDX-License-Identifier: Apache-2.0
"""Measured body length and its rate as smooth functions of time.

A filter wide enough for the camera's noise would smooth the corners that the slack causes. Therefore only the
difference between the measured length and the run's actuation fit is smoothed (by a parabola through the samples within
± HALF_WINDOW, see `simulation.smoothing`), and the fit is added back. Where the fit is correct, the corners remain.
Where it is wrong, the result follows the camera with the filter's bandwidth. The rate is computed in the same way. In
gaps of the camera, the difference is interpolated linearly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from worm_model.arrays import Array
from worm_model.identification.data.observed_run import Recording
from worm_model.identification.fits.actuation_fit import (
    INITIAL_LENGTH,
    ActuationFit,
    actuation_problem,
    fit_actuation,
    predicted_length_change,
)
from worm_model.identification.fits.block_least_squares import own_deviations
from worm_model.identification.fits.robust import OUTLIER, scale_of
from worm_model.simulation.smoothing import smooth

HALF_WINDOW = 2.0  # s, half the width of the filter's window
GRID_STEP = 0.008  # s, step of the smoothed length: a tenth of the fastest time constant of a fin
FINE_STEP = 0.001  # s, step of the differences that yield the rate of the actuation fit


@dataclass(frozen=True)
class MeasuredLength:
    """Length change ΔL of a run on the camera's clock, from the moment at which the slack is taken up.

    Attributes:
        step: time step, s.
        time, length_change, rate: s, m, m/s, shape (n,). The first ΔL is that of the body at rest, and the first rate
            is the rate immediately afterwards.
        initial_length: L0, m.
        initial_spread: standard deviation of L0, m. It results from the noise of the length at rest, and from the
            uncertain effect of a pretension.
        misfit: measured length minus the run's actuation fit at the camera's samples, m, shape (samples,); NaN where a
            marker is hidden.
        outliers: mask of the excluded lengths, shape (samples,).
    """

    step: float
    time: Array
    length_change: Array
    rate: Array
    initial_length: float
    initial_spread: float
    misfit: Array
    outliers: NDArray[np.bool_]


def measured_length(recording: Recording) -> MeasuredLength:
    """Return the smoothed length of a run. The body must follow its command at least roughly."""
    fit = fit_actuation([recording])
    offset, engagement = float(fit.clock_offset[0]), float(fit.engagement[0])

    def modelled(times: Array) -> Array:
        return predicted_length_change(recording, fit.values, times, offset, engagement)

    # The onset is time 0 on the servo's clock, which is −offset on the camera's clock.
    start = engagement - offset
    steps = np.arange(int((recording.end - start) / GRID_STEP) + 1, dtype=np.float64)
    time: Array = start + GRID_STEP * steps
    misfit = recording.length - fit.initial_length[0] - modelled(recording.camera_time)
    outliers = np.abs(misfit - np.nanmedian(misfit)) > OUTLIER * max(scale_of(misfit), 1e-5)
    kept = np.where(outliers | (recording.camera_time < start - HALF_WINDOW), np.nan, misfit)
    smoothed = smooth(recording.camera_time, kept, at=time, before=HALF_WINDOW, after=HALF_WINDOW)
    value, rate = _bridged(smoothed.value), _bridged(smoothed.rate)
    # At the start the body is at rest, so that ΔL is known there.
    fade = np.minimum((time - start) / HALF_WINDOW, 1.0)
    rest = recording.length[recording.at_rest & ~outliers]
    spread = float(max(rest.std(ddof=1), 1e-6) / np.sqrt(rest.size))
    half = 0.5 * FINE_STEP
    steepness = (modelled(time + half) - modelled(np.maximum(time - half, start))) / np.where(
        time - half < start, time + half - start, FINE_STEP
    )
    return MeasuredLength(
        step=GRID_STEP,
        time=time,
        length_change=modelled(time) + fade * value,
        rate=steepness + fade * rate,
        initial_length=float(fit.initial_length[0]),
        initial_spread=float(np.hypot(spread, _spread_by_pretension(recording, fit))),
        misfit=misfit,
        outliers=outliers,
    )


def _spread_by_pretension(recording: Recording, fit: ActuationFit) -> float:
    """Return the standard deviation (m) of L0 that results from subtracting the fitted effect of a pretension."""
    if recording.gait.pretension == 0.0:
        return 0.0
    return float(own_deviations(actuation_problem([recording]), fit.solution, INITIAL_LENGTH)[0])


def _bridged(values: Array) -> Array:
    """Return the values with gaps filled by linear interpolation; zeros if all values are NaN."""
    present = np.isfinite(values)
    if not present.any():
        return np.zeros_like(values)
    index = np.arange(values.size)
    return np.interp(index, index[present], values[present])
