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
from worm_model.simulation.kernel.lag import follow_target

Array = NDArray[np.float64]


def clip_phase(stroke: ArrayLike, slack: float) -> Array:
    """Phase 2πft in (0, π] at which the command leaves the slack; π if it never does (S ≤ δ_s). Shape of ``stroke``."""
    ratio = 2.0 * slack / np.asarray(stroke, dtype=float)
    return np.arccos(np.clip(1.0 - ratio, -1.0, 1.0))


def effective_command(command: ArrayLike, slack: float) -> Array:
    """u_eff in m of u_cmd in m (eq:slack_clip), elementwise."""
    return np.minimum(np.asarray(command, dtype=float), -slack)


def length_change_of_command(
    times: ArrayLike, commands: ArrayLike, parameters: Parameters, start: float = 0.0
) -> Array:
    """ΔL in m at ``times`` of a sampled command, piecewise linear between samples, exact.

    ``times`` (n,) in s, not decreasing; ``commands`` (n,) in m; ``start`` is ΔL at the first time, m. The
    clip is applied to the samples, so that within the one interval in which the command crosses −δ_s the
    effective command is the chord. Raises ValueError if the shapes differ.
    """
    time = np.asarray(times, dtype=float)
    target = parameters.gain * effective_command(commands, parameters.slack)
    if time.shape != target.shape or time.ndim != 1:
        raise ValueError(
            f"times {time.shape} and commands {target.shape} must be one-dimensional and equally long"
        )
    length_change = np.empty_like(target)
    follow_target(time, target, parameters.time_constant, start, length_change)
    return length_change


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
