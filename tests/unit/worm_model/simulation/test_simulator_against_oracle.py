# SPDX-License-Identifier: Apache-2.0
"""The simulator, compared with an independent integration."""

import numpy as np
import pytest
from oracle import Oracle
from random_cases import random_case, random_dry_case, random_loaded_case, seeds

from worm_model.gait import Gait
from worm_model.parameters import PAPER
from worm_model.simulation.simulator import evaluate_gait, simulate

POSITION_TOLERANCE = 1e-9  # m
POWER_TOLERANCE = 1e-6  # relative


CASES = (
    # 104: no clearance, a region without width must not hold a fin forever; 900: a fin at rest on its border;
    # 363326: a fin approaches its border forever, at resonance
    (random_case, (*seeds(45), 104, 900, 363326)),
    # from 7791 on: a new segment begins while both modules rest and the rate of ΔL is about to reverse
    (random_dry_case, (*seeds(18), 7791, 10132, 14494, 15686, 16703)),
    (random_loaded_case, (*seeds(42), 10425, 19323)),
)


@pytest.mark.parametrize(("make", "seed"), [(make, seed) for make, all in CASES for seed in all])
def test_random_gaits_agree_with_the_oracle(make, seed: int) -> None:
    _, gait, parameters = make(seed)
    result = evaluate_gait(gait, parameters)
    trajectory = simulate(gait, parameters)
    oracle = Oracle(gait, parameters).run()

    cycle_starts = np.arange(6) * gait.period
    expected = [x1 for x1, _ in oracle.boundaries]
    assert trajectory.at(cycle_starts).x1 == pytest.approx(expected, rel=0, abs=POSITION_TOLERANCE)
    power = parameters.idle_power + parameters.power_factor * oracle.work(3) * gait.frequency
    assert result.power == pytest.approx(power, rel=POWER_TOLERANCE)
    assert result.switches == oracle.switches
    advance = gait.direction * oracle.advance(3)
    assert result.grooves_per_cycle == pytest.approx(advance / parameters.pitch, abs=1e-7)
    times = [event.time for event in trajectory.events() if event.switched]
    assert times == pytest.approx(oracle.switch_times, abs=1e-7)


@pytest.mark.parametrize(
    ("gait", "parameters"),
    [
        (Gait(0.0755, 0.15, margin=0.0034), PAPER),
        (Gait(0.07, 0.2), PAPER.replace(rear_dry_friction=1.3, front_dry_friction=0.6)),
    ],
    ids=["margin", "dry friction"],
)
def test_positions_between_cycles_agree_with_the_oracle(gait: Gait, parameters) -> None:
    times = np.linspace(0.01, 5 * gait.period, 97)
    oracle = Oracle(gait, parameters).run(samples=times)
    states = np.concatenate(oracle.states, axis=1)
    motions = simulate(gait, parameters).at(np.concatenate(oracle.times))
    assert motions.x1 == pytest.approx(states[0], abs=POSITION_TOLERANCE)
    assert motions.v1 == pytest.approx(states[1], abs=1e-7)
    assert motions.length - PAPER.initial_length == pytest.approx(states[2], abs=1e-11)
    assert motions.energy == pytest.approx(
        parameters.idle_power * motions.time + parameters.power_factor * states[3], rel=1e-8
    )
