# SPDX-License-Identifier: Apache-2.0
"""Source energy of a run whose length rate and cable force are sampled, equal to the bit to the same sums by NumPy.

The fit of the energy model evaluates it tens of thousands of times. NumPy takes ten times as long for arrays of this
size.
"""

from __future__ import annotations

import numpy as np

from worm_model.simulation.kernel.compiled import exact


@exact
def sampled_energy(
    time: np.ndarray,
    rate: np.ndarray,
    static_force: np.ndarray,
    idle: float,
    one_sided_cable: bool,
    damping: float,
    factor: float,
    at: np.ndarray,
) -> np.ndarray:
    """Return the energy (m,) in J since the first of the times ``at`` (m,), s, ascending.

    The power is ``idle`` (W) plus ``factor`` times the power of the cable (`kernel.work.cable_power`) with the force
    ``static_force`` − ``damping``·``rate``. Between the samples it is interpolated linearly for the energy at the
    samples (trapezoidal rule), and the energy is interpolated linearly between them. Outside of the samples the power
    is ``idle``.

    Args:
        time: times of the samples, s, shape (n,), ascending.
        rate: L̇, m/s, shape (n,).
        static_force: cable force without the damping term, N, shape (n,).
        idle: idle power, W.
        one_sided_cable: True for a cable that cannot push.
        damping: c_b, N·s/m.
        factor: α_P.
        at: times of the result, s.
    """
    last = time.size - 1
    energy, before = np.empty(time.size), 0.0
    for k in range(time.size):
        force = static_force[k] - damping * rate[k]
        if one_sided_cable:
            force = max(force, 0.0)
        power = idle + factor * max(-force * rate[k], 0.0)
        energy[k] = (
            0.0 if k == 0 else energy[k - 1] + 0.5 * (power + before) * (time[k] - time[k - 1])
        )
        before = power
    values, k = np.empty(at.size), 0
    for i in range(at.size):
        moment = at[i]
        while k < last and time[k + 1] <= moment:
            k += 1
        if moment <= time[0]:
            inside = energy[0]
        elif k == last or time[k] == moment:
            inside = energy[k]
        else:
            slope = (energy[k + 1] - energy[k]) / (time[k + 1] - time[k])
            inside = slope * (moment - time[k]) + energy[k]
        outside = min(moment - time[0], 0.0) + max(moment - time[last], 0.0)
        values[i] = inside + idle * outside
    return values - values[0]
