# SPDX-License-Identifier: Apache-2.0
"""The measured body length as a function of time, smoothed in a stated way, with its rate.

A filter that is wide enough to still the camera's noise would round off the corners that the slack makes.
So only the difference between the measured length and what the run's own actuation fit says is smoothed (a
parabola through the samples within ± HALF_WINDOW, `simulation.smoothing`), and the fit is added again: where the
model is right nothing is lost, where it is wrong the camera has the last word, at the filter's pace. The rate
is treated alike. Gaps are bridged by the fit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from worm_model.arrays import Array
from worm_model.identification.actuation_fit import (
    fit_actuation,
    predicted_length_change,
)
from worm_model.identification.observed_run import Recording
from worm_model.identification.robust import OUTLIER, scale_of
from worm_model.simulation.smoothing import smooth

HALF_WINDOW = 2.0  # s
GRID_STEP = 0.008  # s, of the smoothed length: a tenth of the fastest relaxation of a fin
FINE_STEP = 0.001  # s, for the rate of the actuation fit


@dataclass(frozen=True)
class MeasuredLength:
    """ΔL of a run on the camera's clock, from the onset on in steps of ``step`` s.

    ``time``, ``length_change``, ``rate`` (n,): s, m, m/s, at rest at the first; ``initial_length`` m and
    ``initial_spread``, the standard deviation of its mean at rest; ``misfit`` (samples,) m: measured minus the run's
    own actuation fit; ``outliers`` (samples,): which lengths were left out.
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
    """Smooths the length of a run that follows its command, however roughly."""
    fit = fit_actuation([recording])
    offset, engagement = float(fit.clock_offset[0]), float(fit.engagement[0])

    def modelled(times: Array) -> Array:
        return predicted_length_change(recording, fit.values, times, offset, engagement)

    # The gait begins on the servo's clock, at −offset on the camera's.
    start = engagement - offset
    steps = np.arange(int((recording.end - start) / GRID_STEP) + 1, dtype=np.float64)
    time: Array = start + GRID_STEP * steps
    misfit = recording.length - fit.initial_length[0] - modelled(recording.camera_time)
    outliers = np.abs(misfit - np.nanmedian(misfit)) > OUTLIER * max(scale_of(misfit), 1e-5)
    kept = np.where(outliers | (recording.camera_time < start - HALF_WINDOW), np.nan, misfit)
    smoothed = smooth(recording.camera_time, kept, at=time, before=HALF_WINDOW, after=HALF_WINDOW)
    value, rate = _bridged(smoothed.value), _bridged(smoothed.rate)
    fade = np.minimum((time - start) / HALF_WINDOW, 1.0)  # from rest, which L0 stands for
    rest = recording.length[recording.at_rest & ~outliers]
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
        initial_spread=float(max(rest.std(ddof=1), 1e-6) / np.sqrt(rest.size)),
        misfit=misfit,
        outliers=outliers,
    )


def _bridged(values: Array) -> Array:
    """What is missing in a gap, on a straight line between its ends."""
    present = np.isfinite(values)
    if not present.any():
        return np.zeros_like(values)
    index = np.arange(values.size)
    return np.interp(index, index[present], values[present])
