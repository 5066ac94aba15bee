# SPDX-License-Identifier: Apache-2.0
"""Measured body length and its rate as smooth functions of time.

A filter wide enough for the camera's noise would smooth the corners that the slack causes. Therefore only the
difference between the measured length and the run's actuation fit is smoothed (by a parabola through the samples within
± HALF_WINDOW, see `simulation.smoothing`), and the fit is added back. Where the fit is correct, the corners remain.
Where it is wrong, the result follows the camera with the filter's bandwidth. The rate is computed in the same way. In
gaps of the camera, the difference is interpolated linearly.

If the fit does not explain the length (a compliant cable, a slack that is taken up slowly), its corners are not those
of the body. Then the length itself is smoothed, with a narrower filter.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from worm_model.arrays import Array
from worm_model.identification.data.observed_run import Recording
from worm_model.identification.fits.actuation_fit import (
    INITIAL_LENGTH,
    ActuationFit,
    fit_actuation,
    predicted_length_change,
)
from worm_model.identification.fits.block_least_squares import own_deviations
from worm_model.identification.fits.estimate import OUTLIER, noise_of, scale_of
from worm_model.parameters import PAPER
from worm_model.simulation.actuation import resting_change
from worm_model.simulation.smoothing import smooth

HALF_WINDOW = 2.0  # s, half the width of the filter's window
NARROW_WINDOW = 0.25  # s, the same if the actuation fit does not explain the length
AVERAGED = 9  # number of samples in the window of a moving median
# The fit explains the length if no moving median of the difference exceeds this many standard deviations of the
# camera's noise, nor this length in m. Healthy robots of the model reach 1.6 standard deviations.
EXPLAINED, LEAST_UNEXPLAINED = 2.0, 5e-4
GRID_STEP = 0.008  # s, step of the smoothed length: a tenth of the fastest time constant of a fin
FINE_STEP = 0.001  # s, step of the differences that yield the rate of the actuation fit


@dataclass(frozen=True)
class MeasuredLength:
    """Length change ΔL of a run on the camera's clock, from the moment at which the slack is taken up.

    Attributes:
        time, length_change, rate: s, m, m/s, shape (n,). The first ΔL is that of the body at rest, and the first rate
            is the rate immediately afterwards.
        initial_length: L0, m.
        initial_spread: standard deviation of L0, m. It results from the noise of the length at rest, and from the
            uncertain effect of a pretension.
        misfit: measured length minus the run's actuation fit at the camera's samples, m, shape (samples,); NaN where a
            marker is hidden.
        outliers: mask of the excluded lengths, shape (samples,).
        explained: True if the run's actuation fit explains the length.
    """

    time: Array
    length_change: Array
    rate: Array
    initial_length: float
    initial_spread: float
    misfit: Array
    outliers: NDArray[np.bool_]
    explained: bool


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
    limit = max(EXPLAINED * noise_of(recording.length), LEAST_UNEXPLAINED)
    explained = bool(np.abs(moving_median(misfit)).max(initial=0.0) <= limit)
    if not explained:
        return _followed(recording, fit, misfit)
    outliers = np.abs(misfit - np.nanmedian(misfit)) > OUTLIER * max(scale_of(misfit), 1e-5)
    half = 0.5 * FINE_STEP
    steepness = (modelled(time + half) - modelled(np.maximum(time - half, start))) / np.where(
        time - half < start, time + half - start, FINE_STEP
    )
    value, rate = _smoothed(recording.camera_time, misfit, outliers, time, HALF_WINDOW)
    fade = np.minimum((time - start) / HALF_WINDOW, 1.0)  # ΔL is known at the start, at rest
    return MeasuredLength(
        time=time,
        length_change=modelled(time) + fade * value,
        rate=steepness + fade * rate,
        initial_length=float(fit.initial_length[0]),
        initial_spread=_initial_spread(recording, fit, outliers),
        misfit=misfit,
        outliers=outliers,
        explained=True,
    )


def _followed(recording: Recording, fit: ActuationFit, misfit: Array) -> MeasuredLength:
    """Return the length of a run that the actuation fit does not explain, from the onset on."""
    present = np.isfinite(misfit)
    local = np.full_like(misfit, np.nan)
    local[present] = misfit[present] - median_filter(misfit[present], AVERAGED)
    outliers = np.abs(local) > OUTLIER * max(scale_of(local), 1e-5)
    rest = float(np.median(recording.length[recording.at_rest & ~outliers]))
    time = GRID_STEP * np.arange(int(recording.end / GRID_STEP) + 1, dtype=np.float64)
    value, rate = _smoothed(
        recording.camera_time, recording.length - rest, outliers, time, NARROW_WINDOW
    )
    fade = np.minimum(time / NARROW_WINDOW, 1.0)  # the body is at rest at the start
    slack, gain, _ = fit.values
    change = resting_change(recording.gait, PAPER.replace(slack=slack, gain=gain))
    return MeasuredLength(
        time=time,
        length_change=change + value - (1.0 - fade) * value[0],
        rate=rate,
        initial_length=rest - change,
        initial_spread=_initial_spread(recording, fit, outliers),
        misfit=misfit,
        outliers=outliers,
        explained=False,
    )


def moving_median(values: Array, window: int = AVERAGED) -> Array:
    """Return the medians of ``window`` successive finite values, or of all if there are fewer."""
    finite = values[np.isfinite(values)]
    if not finite.size:
        return finite
    windows = sliding_window_view(finite, min(window, finite.size))
    median: Array = np.median(windows, axis=-1)
    return median


def _smoothed(
    camera_time: Array, values: Array, outliers: NDArray[np.bool_], time: Array, window: float
) -> tuple[Array, Array]:
    """Return smoothed values (n,) and their rates (n,) at the times ``time``; gaps are bridged."""
    kept = np.where(outliers | (camera_time < time[0] - window), np.nan, values)
    smoothed = smooth(camera_time, kept, at=time, before=window, after=window)
    return _bridged(smoothed.value), _bridged(smoothed.rate)


def _initial_spread(recording: Recording, fit: ActuationFit, outliers: NDArray[np.bool_]) -> float:
    """Return the standard deviation of L0, m; with a pretension it includes that of the fitted effect on the length."""
    rest = recording.length[recording.at_rest & ~outliers]
    spread = float(max(rest.std(ddof=1), 1e-6) / np.sqrt(rest.size))
    if recording.gait.pretension == 0.0:
        return spread
    return float(np.hypot(spread, own_deviations(fit.problem, fit.solution, INITIAL_LENGTH)[0]))


def _bridged(values: Array) -> Array:
    """Return the values with gaps filled by linear interpolation; zeros if all values are NaN."""
    present = np.isfinite(values)
    if not present.any():
        return np.zeros_like(values)
    index = np.arange(values.size)
    return np.interp(index, index[present], values[present])
