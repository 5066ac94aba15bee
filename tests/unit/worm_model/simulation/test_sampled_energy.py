# SPDX-License-Identifier: Apache-2.0
"""The compiled energy of sampled runs, compared with the same sums by NumPy."""

import numpy as np
import pytest

from worm_model.arrays import accumulated
from worm_model.simulation.kernel.sampled_energy import sampled_energy


@pytest.mark.parametrize("one_sided", [False, True])
@pytest.mark.parametrize("samples", [1, 2, 300])
def test_the_energy_is_that_of_numpy_to_the_bit(samples: int, one_sided: bool) -> None:
    random = np.random.default_rng(samples)
    time = np.cumsum(random.exponential(0.008, samples))
    rate, static = random.normal(0.0, 0.05, samples), random.normal(0.0, 30.0, samples)
    at = random.uniform(time[0] - 0.2, time[-1] + 0.2, 200)
    at[::5] = random.choice(time, 40)  # at samples, too
    at.sort()
    idle, damping, factor = 2.7, 860.0, 3.2

    force = static - damping * rate
    if one_sided:
        force = np.maximum(force, 0.0)
    power = idle + factor * np.maximum(-force * rate, 0.0)
    outside = np.minimum(at - time[0], 0.0) + np.maximum(at - time[-1], 0.0)
    expected = np.interp(at, time, accumulated(time, power)) + idle * outside
    expected -= expected[0]

    found = sampled_energy(time, rate, static, idle, one_sided, damping, factor, at)
    assert found.tobytes() == expected.tobytes()
    assert samples == 1 or np.ptp(found) > idle * np.ptp(at)
