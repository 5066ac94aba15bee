# SPDX-License-Identifier: Apache-2.0
"""Dry friction of the model, compared with balances and limits."""

import numpy as np
import pytest

from worm_model.gait import Gait
from worm_model.parameters import PAPER
from worm_model.simulation.simulator import Locomotion, evaluate_gait, simulate

GAIT = Gait(0.07, 0.2)


def with_dry(rear, front, **more):
    return PAPER.replace(rear_dry_friction=rear, front_dry_friction=front, **more)


def test_a_module_that_sticks_does_not_move():
    motions = simulate(GAIT, with_dry(500.0, 0.0)).at(np.linspace(0.0, 25.0, 400))
    assert motions.x1 == pytest.approx(0.0, abs=1e-15)  # rounding of y
    assert motions.v1 == pytest.approx(0.0, abs=1e-15)
    assert np.ptp(motions.x2) > 0.04


def test_the_cable_pays_for_what_friction_and_damping_take():
    # The stroke is so short that no anchor switches: the springs return the energy that they stored.
    gait, parameters = Gait(0.02, 0.2), with_dry(0.7, 0.4)
    trajectory = simulate(gait, parameters, cycles=8)
    assert not any(event.switched for event in trajectory.events())
    time = np.linspace(6 * gait.period, 7 * gait.period, 200_001)
    motions = trajectory.at(time)
    p = parameters
    dissipated = p.viscous_friction * (motions.v1**2 + motions.v2**2)
    dissipated += p.bellows_damping * motions.length_rate**2
    dissipated += p.rear_dry_friction * np.abs(motions.v1) + p.front_dry_friction * np.abs(
        motions.v2
    )
    given = -motions.cable_force * motions.length_rate
    assert np.trapezoid(given, time) == pytest.approx(np.trapezoid(dissipated, time), rel=1e-5)


def test_less_and_less_dry_friction_is_none():
    exact = evaluate_gait(GAIT, PAPER).power
    found = [evaluate_gait(GAIT, with_dry(dry, dry)).power for dry in (1e-3, 1e-5, 1e-12)]
    assert found == pytest.approx([exact] * 3, rel=1e-4)
    assert abs(found[1] - exact) < 0.02 * abs(found[0] - exact)


def test_a_body_that_rests_stays_until_its_fins_push_too_hard():
    """ΔL is constant: both modules stick together, and hold up to the sum of their frictions."""
    bent = 0.001  # deflection of both fins beyond their clearance, pushed forward: they slide
    push = 2.0 * bent * PAPER.disengaged_stiffness
    for share in (0.6, 0.3):  # of the push that each module can hold
        parameters = with_dry(share * push, share * push, initial_length=17 * PAPER.pitch)
        model, x1 = Locomotion(parameters), 0.5 * PAPER.clearance + bent
        _, motions = model.follow(model.start(x1=x1), [2.0, 4.0], [0.0, 0.0])
        left = min(2.0 * share, 1.0) * bent
        assert motions.x1[-1] - 0.5 * PAPER.clearance == pytest.approx(left, abs=1e-8)
        assert motions.v1[-1] == pytest.approx(0.0, abs=1e-9)
