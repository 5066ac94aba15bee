# SPDX-License-Identifier: Apache-2.0
"""The slack-aware actuation model (eq:slack_clip, eq:first_order_actuation) in closed form.

Between the moments at which the slack clip opens and closes, u_eff is a constant or a sinusoid, so ΔL is
a constant, a sinusoid and one exponential.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from worm_model.gait import Gait
from worm_model.parameters import Parameters
from worm_model.simulation.kernel.actuation_law import Actuator, respond_at

Array = NDArray[np.float64]


def clip_phase(stroke: ArrayLike, slack: float) -> Array:
    """Phase 2πft in (0, π] at which the command leaves the slack; π if it never does (S ≤ δ_s). Shape of ``stroke``."""
    ratio = 2.0 * slack / np.asarray(stroke, dtype=float)
    return np.arccos(np.clip(1.0 - ratio, -1.0, 1.0))


def effective_command(command: ArrayLike, slack: float) -> Array:
    """u_eff in m of u_cmd in m (eq:slack_clip), elementwise."""
    return np.minimum(np.asarray(command, dtype=float), -slack)


def length_change_of_command(
    times: ArrayLike,
    commands: ArrayLike,
    parameters: Parameters,
    start: float = 0.0,
    at: ArrayLike | None = None,
    engaged: float | None = None,
) -> Array:
    """ΔL in m of a sampled command, piecewise linear between samples, exact.

    ``times`` (n,) in s, not decreasing; ``commands`` (n,) in m; ``at`` (m,) in s, ascending, are the times asked
    for, by default ``times``. ΔL is ``start`` (m) until ``engaged`` (s), by default the first time. Raises
    ValueError if the shapes differ or there is no sample.
    """
    time = np.ascontiguousarray(times, dtype=float)
    command = np.ascontiguousarray(commands, dtype=float)
    if time.shape != command.shape or time.ndim != 1 or not time.size:
        raise ValueError(
            f"times {time.shape} and commands {command.shape} must be one-dimensional, equally long and not empty"
        )
    asked = time if at is None else np.ascontiguousarray(at, dtype=float)
    length_change = np.empty_like(asked)
    since = float(time[0]) if engaged is None else engaged
    respond_at(time, command, since, start, actuator(parameters), asked, length_change)
    return length_change


def actuator(parameters: Parameters) -> Actuator:
    """What the kernel needs of the actuation."""
    return Actuator(parameters.gain, parameters.slack, parameters.time_constant)


def _steady_sinusoid(gait: Gait, parameters: Parameters) -> tuple[float, float, float]:
    """(mean, cosine, sine) of the response to the unclipped command, in m, over the phase 2πft."""
    lag = 2.0 * np.pi * gait.frequency * parameters.time_constant
    amplitude = 0.5 * parameters.gain * gait.stroke / (1.0 + lag * lag)
    return -0.5 * parameters.gain * gait.stroke, amplitude, amplitude * lag


def length_change_range(gait: Gait, parameters: Parameters) -> tuple[float, float]:
    """Lowest and highest ΔL in m of the gait's periodic steady state (the transient has died out)."""
    rest = -parameters.gain * parameters.slack
    if gait.stroke <= parameters.slack:
        return rest, rest
    opening = float(clip_phase(gait.stroke, parameters.slack))
    closing = 2.0 * np.pi - opening
    mean, cosine, sine = _steady_sinusoid(gait, parameters)
    rate = 1.0 / (
        2.0 * np.pi * gait.frequency * parameters.time_constant
    )  # decay per radian of phase

    def sinusoid(phase: Array | float) -> Array:
        return mean + cosine * np.cos(phase) + sine * np.sin(phase)

    open_decay = np.exp(-rate * (closing - opening))
    clip_decay = np.exp(-rate * 2.0 * opening)
    # Periodicity: ΔL at the opening maps to itself through one open and one clipped interval.
    unclipped = sinusoid(closing) - sinusoid(opening) * open_decay
    at_opening = (rest * (1.0 - clip_decay) + unclipped * clip_decay) / (
        1.0 - open_decay * clip_decay
    )
    transient = at_opening - sinusoid(opening)

    def length_change(phase: Array) -> Array:
        return sinusoid(phase) + transient * np.exp(-rate * (phase - opening))

    # Both extremes lie in the open interval: ΔL still rises a little after the opening.
    lowest = _least(length_change, opening, closing)
    highest = -_least(lambda phase: -length_change(phase), opening, closing)
    return lowest, highest


def _least(function: Callable[[Array], Array], low: float, high: float) -> float:
    """Least value of a function of an array, by a grid that narrows around the best point."""
    for _ in range(4):  # each pass narrows the bracket 200-fold
        points = np.linspace(low, high, 401)
        values = function(points)
        best = int(np.argmin(values))
        low, high = points[max(best - 1, 0)], points[min(best + 1, 400)]
    return float(values[best])
