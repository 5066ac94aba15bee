# SPDX-License-Identifier: Apache-2.0
"""The power of a cable that cannot push, compared with an independent quadrature and with the paper's form."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from random_cases import examples, random_case

from worm_model.analysis.simulated_run import simulated_run
from worm_model.arrays import accumulated
from worm_model.gait import Gait
from worm_model.parameters import PAPER
from worm_model.simulation.kernel.sampled_energy import sampled_energy
from worm_model.simulation.simulator import simulate
from worm_model.twin.offline_replay import replay_run

FAST = Gait(0.09, 0.4)
SLOW = Gait(0.05, 0.08)  # its cable pulls throughout
ONE_SIDED = PAPER.replace(one_sided_cable=True)


@examples(40)
@given(st.integers(0, 2**32 - 1))
def test_motion_is_the_same_and_power_never_more(seed: int) -> None:
    _, gait, parameters = random_case(seed)
    time = np.linspace(0.0, 3.0 * gait.period, 400)
    literal = simulate(gait, parameters).at(time)
    other = simulate(gait, parameters.replace(one_sided_cable=True)).at(time)
    assert np.array_equal(literal.x1, other.x1)
    assert np.array_equal(literal.cable_force, other.cable_force)
    pushed = literal.cable_force < 0.0
    assert np.array_equal(other.power, np.where(pushed, parameters.idle_power, literal.power))
    assert np.all(np.diff(other.energy) <= np.diff(literal.energy) + 1e-9)


def test_the_twin_bills_nothing_where_the_cable_would_push() -> None:
    run = simulated_run(FAST, PAPER, 3, 100.0).as_recorded()
    literal, other = (replay_run(run, p).states for p in (PAPER, ONE_SIDED))
    pushed = literal["cable_force"] < 0.0
    assert np.any(pushed & (literal["power"] > 1.1 * PAPER.idle_power))
    assert np.array_equal(
        other["power"], np.where(pushed, PAPER.idle_power, literal["power"]), equal_nan=True
    )
    assert other["energy"][-1] < 0.9 * literal["energy"][-1]
    assert np.array_equal(other["rear_position"], literal["rear_position"])


@pytest.mark.parametrize("one_sided", [False, True])
@pytest.mark.parametrize("samples", [1, 2, 300])
def test_the_energy_of_sampled_runs_is_that_of_numpy_to_the_bit(
    samples: int, one_sided: bool
) -> None:
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
