# SPDX-License-Identifier: Apache-2.0
"""Runs from rest in grooves that differ, against even grooves and against the simulator."""

import numpy as np
import pytest

from worm_model.gait import FORWARD, REVERSE, Gait
from worm_model.parameters import PAPER
from worm_model.simulation.kernel import march
from worm_model.simulation.kernel.grooves import (
    EVEN,
    FIRST_GROOVE,
    GROOVE_COLUMNS,
    STIFFNESS,
    THRESHOLD,
)
from worm_model.simulation.kernel.whole_run import run_from_rest
from worm_model.simulation.rows import parameter_rows
from worm_model.simulation.simulator import Locomotion, simulate
from worm_model.simulation.smoothing import Smoothed

STEP = 0.03  # s, between the knots of the length
GAITS = [Gait(0.07, 0.2), Gait(0.06, 0.1), Gait(0.09, 0.4)]
DRY = PAPER.replace(rear_dry_friction=0.12, front_dry_friction=0.03)


def cubics(gait, cycles=3):
    times = np.arange(0.0, cycles / gait.frequency, STEP)
    motion = simulate(gait, PAPER, cycles).at(times)
    return Smoothed(times, motion.length - PAPER.initial_length, motion.length_rate).cubic()


def follow(gait, parameters=PAPER, direction=FORWARD, rear=EVEN, front=EVEN, **start):
    """The samples at the knots of the length of a gait."""
    breaks, coefficients = cubics(gait)
    samples = np.empty((breaks.size, march.SAMPLE_COLUMNS))
    samples[:, march.TIME] = breaks
    row = parameter_rows(parameters)[0]
    start = {"deflection": 0.0, "onset": 0.0, **start}
    assert run_from_rest(
        breaks, coefficients, row, float(direction), *start.values(), rear, front, samples
    )
    return samples


@pytest.mark.parametrize("parameters", [PAPER, DRY])
@pytest.mark.parametrize("gait", GAITS)
@pytest.mark.parametrize("direction", [FORWARD, REVERSE])
def test_in_even_grooves_it_is_the_simulator(gait, direction, parameters):
    breaks, coefficients = cubics(gait)
    model = Locomotion(parameters, direction)
    _, motions = model.follow_polynomial(model.start(), breaks, coefficients, breaks)
    samples = follow(gait, parameters, direction)
    assert samples[:, march.X1] == pytest.approx(motions.x1, abs=1e-12)
    assert samples[:, march.FORCE] == pytest.approx(motions.cable_force, abs=1e-8)


def test_the_length_may_begin_with_the_rear_module_at_rest():
    """As in the paper's initial values: v1(0) = 0 where ΔL begins with a rate."""
    shared, held = (follow(GAITS[0], onset=onset)[0] for onset in (0.0, 1.0))
    assert held[march.V1] == pytest.approx(0.0, abs=1e-12)
    rate = held[march.LENGTH_RATE]
    assert shared[march.V1] == pytest.approx(-rate * PAPER.front_mass / PAPER.mass)


@pytest.mark.parametrize("parameters", [DRY, DRY.replace(rear_load=0.5)])
@pytest.mark.parametrize("length_change", [-0.008, -0.015, -0.03])
def test_a_pretension_bends_the_fins_to_their_balance_from_which_a_pose_deviates(
    length_change, parameters
):
    model = Locomotion(PAPER)
    balance = model.at_rest(length_change=length_change)
    for deflection in (0.0, 1e-4):
        samples = np.zeros((1, march.SAMPLE_COLUMNS))
        held = np.array([[length_change], [0.0], [0.0], [0.0]])
        row = parameter_rows(parameters)[0]
        assert run_from_rest(np.arange(2.0), held, row, 1.0, deflection, 0.0, EVEN, EVEN, samples)
        assert samples[0, march.X1] == pytest.approx(model.x1(balance) + deflection, abs=1e-9)
        assert samples[0, march.X2] == pytest.approx(model.x2(balance) + deflection, abs=1e-9)
        grooves = samples[0, [march.REAR_GROOVE, march.FRONT_GROOVE]]
        assert tuple(grooves) == (balance.rear_groove, balance.front_groove)


def test_a_groove_with_a_higher_threshold_is_left_later():
    rear = np.zeros((10, GROOVE_COLUMNS))
    rear[FIRST_GROOVE, THRESHOLD] = 1e-3
    plain, moved = (follow(GAITS[0], rear=grooves) for grooves in (EVEN, rear))
    first = np.flatnonzero(np.abs(plain[:, march.X1] - moved[:, march.X1]) > 1e-6)[0]
    assert plain[first, march.X1] == pytest.approx(PAPER.switching_threshold, abs=1e-3)
    assert plain[first, march.REAR_GROOVE] == 1.0
    assert moved[first, march.REAR_GROOVE] == 0.0
    assert moved[first, march.X1] < plain[first, march.X1]


def test_grooves_count_from_the_start_of_each_module():
    """A deviation of the front module's first groove has no effect once the module has left it."""
    front = np.zeros((10, GROOVE_COLUMNS))
    front[FIRST_GROOVE, STIFFNESS] = 0.2
    plain, moved = (follow(GAITS[2], front=grooves) for grooves in (EVEN, front))
    in_first = plain[:, march.FRONT_GROOVE] == plain[0, march.FRONT_GROOVE]
    force = np.abs(plain[:, march.FRONT_FORCE] - moved[:, march.FRONT_FORCE])
    assert force[in_first].max() > 0.1
    assert force[-10:].max() < 1e-3 * force[in_first].max()


def test_grooves_that_are_all_stiffer_are_stiffer_fins():
    stiff = np.zeros((10, GROOVE_COLUMNS))
    stiff[:, STIFFNESS] = 0.1
    fins = PAPER.replace(
        engaged_stiffness=1.1 * PAPER.engaged_stiffness,
        disengaged_stiffness=1.1 * PAPER.disengaged_stiffness,
    )
    by_groove = follow(GAITS[2], rear=stiff, front=stiff)
    assert by_groove == pytest.approx(follow(GAITS[2], fins), rel=1e-9, abs=1e-9)
