# SPDX-License-Identifier: Apache-2.0
"""The locomotion model with dry friction, compared with the exact simulator and with itself."""

import numpy as np
import pytest

from worm_model.gait import FORWARD, REVERSE, Gait
from worm_model.identification.fits.locomotion import worm_of
from worm_model.parameters import PAPER
from worm_model.simulation.kernel import stepped_dry_friction as kernel
from worm_model.simulation.simulator import Locomotion, simulate

STEP = 0.008  # s, as in the identification
GAITS = [Gait(0.07, 0.2), Gait(0.06, 0.1), Gait(0.09, 0.4)]
ALIKE = np.zeros((1, kernel.GROOVE_COLUMNS))


def length_changes(gait, step, cycles=3):
    times = np.arange(0.0, cycles / gait.frequency, step)
    return times, simulate(gait, PAPER, cycles).at(times).length - PAPER.initial_length


def slide(step, changes, worm, rear=ALIKE, front=ALIKE):
    samples = np.empty((changes.size, kernel.SAMPLE_COLUMNS))
    return kernel.slide(step, changes, worm, rear, front, samples), samples


@pytest.mark.parametrize("gait", GAITS)
@pytest.mark.parametrize("direction", [FORWARD, REVERSE])
def test_without_dry_friction_it_is_the_exact_model(gait, direction):
    times, changes = length_changes(gait, STEP)
    switches, samples = slide(STEP, changes, worm_of(PAPER, direction))
    model = Locomotion(PAPER, direction)
    state, motions = model.follow(model.start(), times[1:], changes[1:])
    assert switches == state.switches
    assert np.sqrt(np.mean((samples[1:, kernel.X1] - motions.x1) ** 2)) < 3e-6
    body = PAPER.bellows_stiffness * (PAPER.unstressed_length - motions.length)
    force = samples[1:, kernel.HOLDING_FORCE] + body
    force -= PAPER.bellows_damping * motions.length_rate
    work = np.sum(np.maximum(-force * motions.length_rate, 0.0))
    exact = np.sum(np.maximum(-motions.cable_force * motions.length_rate, 0.0))
    assert work == pytest.approx(exact, rel=2e-3)


def test_with_dry_friction_it_is_near_the_exact_model():
    """Its friction fades below 1 mm/s and its lengths have a step: 0.06 mm, a quarter of a camera's noise."""
    dry = PAPER.replace(rear_dry_friction=0.12, front_dry_friction=0.03)
    for gait in GAITS:
        times, changes = length_changes(gait, STEP)
        worm = worm_of(PAPER, FORWARD)._replace(rear_dry=0.12, front_dry=0.03)
        switches, samples = slide(STEP, changes, worm)
        model = Locomotion(dry)
        state, motions = model.follow(model.start(), times[1:], changes[1:])
        assert switches == state.switches
        assert np.sqrt(np.mean((samples[1:, kernel.X1] - motions.x1) ** 2)) < 6e-5


def test_the_step_hardly_matters_with_dry_friction():
    gait = GAITS[0]
    worm = worm_of(PAPER, FORWARD)._replace(rear_dry=0.4, front_dry=0.2)
    _, fine = slide(STEP / 16, length_changes(gait, STEP / 16)[1], worm)
    _, coarse = slide(STEP, length_changes(gait, STEP)[1], worm)
    difference = coarse[:, kernel.X1] - fine[::16, kernel.X1][: coarse.shape[0]]
    assert np.sqrt(np.mean(difference**2)) < 5e-6


def test_dry_friction_of_one_module_leaves_it_behind():
    gait = GAITS[1]
    _, changes = length_changes(gait, STEP)
    worm = worm_of(PAPER, FORWARD)
    at = int(1.5 / STEP)  # both fins in their clearance: only friction divides the contraction
    free = slide(STEP, changes, worm)[1][at, kernel.X1]
    held = slide(STEP, changes, worm._replace(rear_dry=0.3))[1][at, kernel.X1]
    assert 0.0 < held < free - 5e-4


def test_a_groove_with_a_higher_threshold_is_left_later():
    gait = GAITS[0]
    _, changes = length_changes(gait, STEP)
    worm = worm_of(PAPER, FORWARD)
    rear = np.zeros((10, kernel.GROOVE_COLUMNS))
    rear[kernel.FIRST_GROOVE, kernel.THRESHOLD] = 1e-3
    plain = slide(STEP, changes, worm)[1][:, kernel.X1]
    moved = slide(STEP, changes, worm, rear=rear)[1][:, kernel.X1]
    first = np.flatnonzero(np.abs(plain - moved) > 1e-6)[0]
    assert plain[first] == pytest.approx(PAPER.switching_threshold, abs=1e-3)
    assert moved[first] < plain[first]


def test_grooves_that_are_all_stiffer_are_stiffer_fins():
    gait = GAITS[2]
    _, changes = length_changes(gait, STEP)
    stiff = np.zeros((10, kernel.GROOVE_COLUMNS))
    stiff[:, kernel.STIFFNESS] = 0.1
    by_groove = slide(STEP, changes, worm_of(PAPER, FORWARD), stiff, stiff)[1]
    fins = PAPER.replace(
        engaged_stiffness=1.1 * PAPER.engaged_stiffness,
        disengaged_stiffness=1.1 * PAPER.disengaged_stiffness,
    )
    by_fin = slide(STEP, changes, worm_of(fins, FORWARD))[1]
    assert by_groove == pytest.approx(by_fin, rel=1e-9, abs=1e-12)
