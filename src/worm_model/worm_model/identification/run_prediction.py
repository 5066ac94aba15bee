# SPDX-License-Identifier: Apache-2.0
"""Prediction of a run by the exact model with given parameters and the run's own L0, and errors of the prediction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from worm_model.analysis.run_metrics import root_mean_square
from worm_model.arrays import Array, accumulated
from worm_model.identification.fits.actuation_fit import predicted_length_change
from worm_model.identification.run_selection import FittedRun
from worm_model.parameters import Parameters
from worm_model.simulation.simulator import Locomotion, SimulationError
from worm_model.simulation.smoothing import Smoothed


@dataclass(frozen=True)
class RunPrediction:
    """Predicted quantities along a run.

    Attributes:
        time: time on the camera's clock, s, shape (n,).
        x1: position of the rear module that follows from the measured length, relative to its position at rest, m,
            shape (n,).
        power: predicted source power, W, shape (n,).
        energy: integral of the power since the first time, J, shape (n,).
        length_change: ΔL that follows from the command, at the camera's samples, m, shape (samples,).
    """

    time: Array
    x1: Array
    power: Array
    energy: Array
    length_change: Array


@dataclass(frozen=True)
class Errors:
    """Errors of a prediction over the traverse, which ends when x1 has advanced by five pitches.

    ``x1_rmse`` (m), ``length_rmse`` (of ΔL without outliers, m) and ``power_rmse`` (W) are root mean squares.
    ``energy_error`` is the predicted minus the measured energy, relative to the measured energy. Without power samples,
    the errors of power and energy are NaN. If the power samples do not cover the traverse, the error of the energy is
    NaN. For the traverse see `locomotion.Traverse`.
    """

    x1_rmse: float
    length_rmse: float
    power_rmse: float
    energy_error: float


def predict(run: FittedRun, parameters: Parameters, clock_offset: float = 0.0) -> RunPrediction:
    """Predict a run with the initial length that was measured in it.

    If the anchors switch endlessly with these parameters, x1, power and energy are NaN.
    ``clock_offset`` (s) is positive if the camera's stamps are early, see `ActuationFit`.
    """
    recording, length = run.recording, run.length
    values = parameters.replace(initial_length=length.initial_length)
    time, change, rate = length.time, length.length_change, length.rate
    model = Locomotion(values, run.traverse.direction)
    breaks, coefficients = Smoothed(time, change, rate).cubic()
    start = model.at_rest(float(time[0]), float(change[0]))
    try:
        _, motions = model.follow_polynomial(start, breaks, coefficients, breaks)
        x1, power = motions.x1 - model.x1(start), motions.power
    except SimulationError:
        x1 = power = np.full(time.size, np.nan)
    actuation = np.array([values.slack, values.gain, values.time_constant])
    return RunPrediction(
        time=time,
        x1=x1,
        power=power,
        energy=accumulated(time, power),
        length_change=predicted_length_change(
            recording, actuation, recording.camera_time, clock_offset
        ),
    )


def run_errors(run: FittedRun, parameters: Parameters, clock_offset: float) -> Errors:
    """Return the errors of a prediction over the traverse; for the arguments see `predict`."""
    recording, traverse = run.recording, run.traverse
    prediction = predict(run, parameters, clock_offset)
    x1 = traverse.x1 - np.interp(traverse.time, prediction.time, prediction.x1)
    during = (recording.camera_time >= 0.0) & (recording.camera_time <= traverse.end)
    change = recording.length - traverse.length.initial_length - prediction.length_change
    time, power = measured_power(run)
    energy_error = np.nan
    if run.has_power:
        first, last = np.interp(time[[0, -1]], prediction.time, prediction.energy)
        energy_error = float(last - first) / float(accumulated(time, power)[-1]) - 1.0
    return Errors(
        x1_rmse=root_mean_square(x1),
        length_rmse=root_mean_square(change[during & ~traverse.length.outliers]),
        power_rmse=root_mean_square(power - np.interp(time, prediction.time, prediction.power)),
        energy_error=energy_error,
    )


def measured_power(run: FittedRun) -> tuple[Array, Array]:
    """Return times (s) and values (W) of the power samples during the traverse."""
    time = run.recording.power_time
    during = (time >= max(0.0, run.length.time[0])) & (time <= run.traverse.end)
    return time[during], run.recording.power[during]
