# SPDX-License-Identifier: Apache-2.0
"""Source energy of a run whose length rate and cable force are sampled, equal to the bit to the same sums by NumPy.

The fit of the energy model evaluates it tens of thousands of times. NumPy takes ten times as long for arrays of this
size.
"""

from __future__ import annotations

import numpy as np

from worm_model.simulation.kernel.compiled import exact
from worm_model.simulation.kernel.work import cable_power

_cable_power = exact(cable_power)


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

    The power is ``idle`` (W) plus ``factor`` times the power of the cable (`cable_power`) with the force
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
    energy, before = np.empty(time.size), 0.0
    for k in range(time.size):
        force = static_force[k] - damping * rate[k]
        power = idle + factor * _cable_power(force, rate[k], one_sided_cable)
        energy[k] = (
            0.0 if k == 0 else energy[k - 1] + 0.5 * (power + before) * (time[k] - time[k - 1])
        )
        before = power
    outside = np.minimum(at - time[0], 0.0) + np.maximum(at - time[-1], 0.0)
    values = np.interp(at, time, energy) + idle * outside
    return values - values[0]
