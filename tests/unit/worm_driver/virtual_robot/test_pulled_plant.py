# SPDX-License-Identifier: Apache-2.0
"""The plant with a length that follows from the cable's force: an independent integration, and effects of loads."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from worm_driver.virtual_robot.plant import LOOSE, Plant, PlantEffects, make_grooves
from worm_driver.virtual_robot.virtual_settings import load_settings
from worm_msgs.gait import FORWARD

DRY = load_settings().body
BODY = replace(DRY, rear_dry_friction=0.0, front_dry_friction=0.0)
STIFFNESS = 6400.0  # N/m
PULLED = PlantEffects(0.0, 0.0, 0.0, math.inf, STIFFNESS)
RIGID = replace(PULLED, cable_stiffness=0.0)


def plant_of(effects, step=1e-3, body=BODY):
    return Plant(body, effects, *(make_grooves(body, effects, 1 + i) for i in range(2)), step)


def play(plant, stroke, frequency, cycles=2, law=FORWARD):
    """Return the states at every step; the slack is taken up at the first."""
    state, states = plant.at_rest(), []
    for index in range(round(cycles / frequency / plant.step_s)):
        phase = 2 * math.pi * frequency * (index + 1) * plant.step_s
        command = min(-0.5 * stroke * (1 - math.cos(phase)), -1e-9)
        state = plant.step(state, command, (law, law))
        states.append(state)
    return states


def integrated(stroke, frequency, times):
    """Return x1, x2 (2, n) by SciPy:

    two masses, springs and dampers as in the paper, a cable that only pulls, no switches.
    """
    p, half = BODY, 0.5 * BODY.clearance
    front = round(p.initial_length / p.pitch) * p.pitch
    preload = p.bellows_stiffness * (p.unstressed_length - p.initial_length)

    def fin(stretch):
        beyond = np.sign(stretch) * max(abs(stretch) - half, 0.0)
        return (p.engaged_stiffness if stretch < 0 else p.disengaged_stiffness) * beyond

    def rates(time, state):
        x1, x2, v1, v2 = state
        command = -0.5 * stroke * (1 - math.cos(2 * math.pi * frequency * time))
        wound = min(command, -p.slack)
        change = x2 - x1 - p.initial_length
        cable = max(preload + STIFFNESS * (change - wound), 0.0)
        inner = cable + p.bellows_stiffness * (x2 - x1 - p.unstressed_length)
        inner += p.bellows_damping * (v2 - v1)
        a1 = (inner - p.viscous_friction * v1 - fin(x1)) / p.rear_mass
        a2 = (-inner - p.viscous_friction * v2 - fin(x2 - front)) / p.front_mass
        return [v1, v2, a1, a2]

    start = [0.0, p.initial_length, 0.0, 0.0]
    found = solve_ivp(
        rates, (0.0, times[-1]), start, "Radau", times, rtol=1e-8, atol=1e-10, max_step=0.01
    )
    return found.y[:2]


def test_it_is_the_two_mass_model_with_the_cables_force():
    plant = plant_of(PULLED, step=1e-4)
    states = play(plant, 0.025, 0.3, cycles=1)
    assert {state.rear_groove for state in states} == {0}  # no anchor switches, as in the oracle
    times = plant.step_s * np.arange(1, len(states) + 1)
    expected = integrated(0.025, 0.3, times)
    found = np.array([plant.positions(state) for state in states]).T
    assert np.max(np.abs(found - expected)) < 3e-5


def test_the_step_hardly_matters():
    coarse = play(plant_of(PULLED), 0.07, 0.2)
    fine = play(plant_of(PULLED, step=2.5e-4), 0.07, 0.2)
    difference = [
        a.length_change - b.length_change for a, b in zip(coarse, fine[3::4], strict=True)
    ]
    assert np.sqrt(np.mean(np.square(difference))) < 5e-5


def test_without_load_the_gain_is_that_of_two_springs():
    plant = plant_of(PULLED)
    state = plant.at_rest()
    for _ in range(3000):
        state = plant.step(state, -0.05, (LOOSE, LOOSE))
    gain = STIFFNESS / (STIFFNESS + BODY.bellows_stiffness)
    assert state.length_change == pytest.approx(-0.05 * gain, rel=1e-3)


def test_load_changes_the_length_of_a_pulled_plant_only():
    for effects, least, most in ((PULLED, 2e-4, 5e-3), (RIGID, 0.0, 1e-12)):
        held, free = (play(plant_of(effects), 0.07, 0.2, law=law) for law in (FORWARD, LOOSE))
        apart = max(abs(a.length_change - b.length_change) for a, b in zip(held, free, strict=True))
        assert least <= apart <= most


def test_a_cable_never_pushes():
    states = play(plant_of(PULLED), 0.09, 0.4)
    assert min(state.cable_force for state in states) == 0.0
    assert all(state.mechanical_power >= 0.0 for state in states)


def test_it_still_walks():
    plant = plant_of(PULLED, body=DRY)
    states = play(plant, 0.08, 0.2, cycles=5)
    assert plant.positions(states[-1])[0] > 3 * BODY.pitch


def test_the_setting_may_be_left_out(tmp_path):
    assert load_settings().effects.cable_stiffness == 0.0
