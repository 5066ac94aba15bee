# SPDX-License-Identifier: Apache-2.0
"""The power of a cable that cannot push, compared with an independent quadrature and with the paper's form."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from random_cases import examples, random_case

from worm_model.analysis.simulated_run import simulated_run
from worm_model.gait import AVERAGED, CYCLES, Gait
from worm_model.parameters import PAPER
from worm_model.simulation.simulator import evaluate_gait, simulate
from worm_model.twin.offline_replay import replay_run

FAST = Gait(0.09, 0.4)
SLOW = Gait(0.05, 0.08)  # its cable pulls throughout
ONE_SIDED = PAPER.replace(one_sided_cable=True)


def test_the_energy_is_that_of_a_dense_quadrature() -> None:
    first, last = ((CYCLES - AVERAGED) * FAST.period, CYCLES * FAST.period)
    time = np.linspace(first, last, 1_500_001)
    seen = simulate(FAST).at(time)
    tension = np.where(seen.cable_force > 0.0, seen.cable_force, 0.0)
    put_in = np.where(seen.length_rate < 0.0, -tension * seen.length_rate, 0.0)
    power = PAPER.idle_power + PAPER.power_factor * np.trapezoid(put_in, time) / (last - first)
    assert evaluate_gait(FAST, ONE_SIDED).power == pytest.approx(power, rel=1e-6)
    energy = simulate(FAST, ONE_SIDED).at([first, last]).energy
    assert energy[1] - energy[0] == pytest.approx(power * (last - first), rel=1e-6)
    assert evaluate_gait(FAST).power / power - 1.0 == pytest.approx(0.22, abs=0.01)


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


def test_a_cable_that_pulls_throughout_has_the_papers_power() -> None:
    assert simulate(SLOW).at(np.linspace(0.0, CYCLES * SLOW.period, 5000)).cable_force.min() > 0.0
    assert evaluate_gait(SLOW, ONE_SIDED) == evaluate_gait(SLOW)
    assert evaluate_gait(FAST, ONE_SIDED).speed == evaluate_gait(FAST).speed


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
