# SPDX-License-Identifier: Apache-2.0
"""The first-order lag of the actuation (eq:first_order_actuation) along a sampled target, in closed form."""

from __future__ import annotations

import math

import numpy as np

from worm_model.simulation.kernel.compiled import unlocked


@unlocked
def follow_target(
    times: np.ndarray, targets: np.ndarray, time_constant: float, start: float, response: np.ndarray
) -> None:
    """Fills the ``response`` (n,) at ``times`` (n,) in s to targets joined by straight lines, exact.

    Times do not decrease; where two are equal the target steps. ``start`` is the response at the first time.
    """
    value = start
    for k in range(times.size):
        if k:
            step = times[k] - times[k - 1]
            if step > 0.0:
                # The response to a ramp lags it by time_constant·slope; what is left of that decays.
                lag = time_constant * (targets[k] - targets[k - 1]) / step
                decay = math.exp(-step / time_constant)
                value = targets[k] - lag + (value - targets[k - 1] + lag) * decay
        response[k] = value
