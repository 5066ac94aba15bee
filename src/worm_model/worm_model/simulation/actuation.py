# SPDX-License-Identifier: Apache-2.0
"""The slack-aware actuation model (eq:slack_clip, eq:first_order_actuation) in closed form.

Within each part of a cycle (`kernel.waveform`), u_eff is a constant, a line, a parabola or a sinusoid. ΔL then is a
polynomial or a sinusoid, plus one exponential.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from worm_model.arrays import Array
from worm_model.gait import Gait
from worm_model.parameters import Parameters
from worm_model.simulation.kernel.actuation_law import Actuator, respond_at, rest_of, value_at
from worm_model.simulation.kernel.linear import Coefficients
from worm_model.simulation.kernel.waveform import answer_to_part, borders_of
from worm_model.simulation.rows import gait_rows


def effective_command(command: ArrayLike, slack: float) -> Array:
    """Return u_eff in m of u_cmd in m (eq:slack_clip), elementwise."""
    return np.minimum(np.asarray(command, dtype=float), -slack)


def length_change_of_command(
    times: ArrayLike,
    commands: ArrayLike,
    parameters: Parameters,
    start: float = 0.0,
    at: ArrayLike | None = None,
    engaged: float | None = None,
) -> Array:
    """Return the exact ΔL in m for a sampled command that is linear between its samples.

    Args:
        times: times of the samples (n,), s, not decreasing.
        commands: samples (n,), m.
        parameters: parameters of the robot.
        start: ΔL until ``engaged``, m.
        at: times of the result (m,), s, ascending; by default ``times``.
        engaged: time from which ΔL responds, s; by default the first time.
    """
    time = np.ascontiguousarray(times, dtype=float)
    command = np.ascontiguousarray(commands, dtype=float)
    if time.shape != command.shape or time.ndim != 1 or not time.size:
        raise ValueError(
            f"times {time.shape} and commands {command.shape} must be one-dimensional, equally long and not empty"
        )
    query = time if at is None else np.ascontiguousarray(at, dtype=float)
    length_change = np.empty_like(query)
    begin = float(time[0]) if engaged is None else engaged
    respond_at(time, command, begin, start, actuator(parameters), query, length_change)
    return length_change


def actuator(parameters: Parameters) -> Actuator:
    """Return the actuation parameters as the kernel reads them."""
    return Actuator(parameters.gain, parameters.slack, parameters.time_constant)


def resting_change(gait: Gait, parameters: Parameters) -> float:
    """Return ΔL in m at the start of a run: −K·max(o, δ_s) with a pretension o of the gait, otherwise 0."""
    return float(rest_of(gait.pretension, actuator(parameters)))


def length_change_range(gait: Gait, parameters: Parameters) -> tuple[float, float]:
    """Return the lowest and highest ΔL in m of the gait's periodic steady state."""
    lag = parameters.time_constant
    end, _ = _cycle(gait, parameters, 0.0)
    steady = end / -math.expm1(-gait.period / lag)  # a cycle maps ΔL to end + ΔL·e^(−T/τ)
    _, parts = _cycle(gait, parameters, steady)

    def extreme(sign: float, duration: float, form: Coefficients, omega: float) -> float:
        def length_change(time: Array) -> Array:
            smooth = form.one + form.t1 * time + form.t2 * time**2 + form.exp * np.exp(-time / lag)
            return sign * (
                smooth + form.cos * np.cos(omega * time) + form.sin * np.sin(omega * time)
            )

        return sign * _least(length_change, 0.0, duration)

    return min(extreme(1.0, *part) for part in parts), max(extreme(-1.0, *part) for part in parts)


def _cycle(
    gait: Gait, parameters: Parameters, length_change: float
) -> tuple[float, list[tuple[float, Coefficients, float]]]:
    """Return (ΔL in m at the end of a cycle, parts), for a ΔL in m at the start of the cycle.

    A part is (duration in s, ΔL as a function of the time in the part, ω of this function in 1/s).
    """
    row, a = gait_rows(gait)[0], actuator(parameters)
    parts, start = [], 0.0
    for part, end in enumerate(borders_of(0.0, row, a)):
        if end > start:
            form, omega = answer_to_part(part, 0.0, start, length_change, row, a)
            parts.append((end - start, form, omega))
            length_change = value_at(form, end - start, omega, a.time_constant)
            start = end
    return length_change, parts


def _least(function: Callable[[Array], Array], low: float, high: float) -> float:
    """Return the smallest value of a vectorised function, by a grid that narrows around the best point."""
    for _ in range(4):  # each pass narrows the bracket 200-fold
        points = np.linspace(low, high, 401)
        values = function(points)
        best = int(np.argmin(values))
        low, high = points[max(best - 1, 0)], points[min(best + 1, 400)]
    return float(values[best])
