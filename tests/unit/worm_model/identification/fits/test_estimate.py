# SPDX-License-Identifier: Apache-2.0
"""Intervals from profiles, and the rule for values that are not identifiable."""

import numpy as np
import pytest

from worm_model.identification.fits.estimate import (
    Estimate,
    admissible,
    dependence,
    follow_profile,
    if_identifiable,
    not_identifiable,
)
from worm_model.identification.fits.resampling import correlation
from worm_model.identification.locomotion_stage import deviations_of


@pytest.mark.parametrize("guess", [0.01, 1.0, 100.0, -0.3])
def test_a_parabola_is_followed_to_its_rise(guess):
    end = follow_profile(lambda value: (value - 3.0) ** 2, 3.0, 4.0, guess, reach=5.0)
    assert end == pytest.approx(3.0 + np.copysign(2.0, guess), rel=0.03)


def test_an_interval_stays_inside_the_admissible_range():
    assert admissible("viscous_friction", Estimate(31.0, -5.0, 67.0)).low == 0.01
    assert admissible("viscous_friction", Estimate(31.0, 20.0, 67.0)).low == 20.0
    assert np.isnan(admissible("viscous_friction", not_identifiable(31.0, "why")).low)


@pytest.mark.parametrize("guess", [0.1, -1.0])
def test_a_cost_that_never_rises_has_no_end_and_is_not_evaluated_beyond_the_reach(guess):
    evaluated = []

    def cost(value):
        evaluated.append(value)
        return 0.0

    assert follow_profile(cost, 3.0, 4.0, guess, reach=2.0) == np.copysign(np.inf, guess)
    assert np.abs(np.array(evaluated) - 3.0).max() <= 2.0


def test_where_a_cost_jumps_the_far_side_counts():
    end = follow_profile(lambda value: 0.0 if value < 3.7 else 1e4, 3.0, 4.0, 0.1)
    assert 3.7 <= end <= 3.7 + 0.05 * 0.7


@pytest.mark.parametrize(("low", "high"), [(-np.inf, 2.0), (np.nan, np.nan), (0.2, 1.8)])
def test_an_open_or_vague_interval_is_not_identifiable(low, high):
    found = if_identifiable(Estimate(1.0, low, high))
    assert not found.identifiable
    assert np.isnan([found.low, found.high]).all()
    assert found.note
    small = Estimate(1e-4, -1e-4, 3e-4)  # near zero, and small for its kind
    assert if_identifiable(small, usual=8e-3).identifiable
    assert not if_identifiable(small).identifiable


def test_what_does_not_move_is_correlated_with_nothing():
    moving = np.random.default_rng(0).normal(size=120)
    found = correlation(np.stack([moving, np.zeros(120), 2.0 * moving], axis=1))
    assert found[0] == pytest.approx([1.0, 0.0, 1.0])


def test_deviations_make_up_their_covariance_also_without_rank():
    covariance = np.diag([1e-10, 0.0, 100.0])
    covariance[0, 2] = covariance[2, 0] = 5e-6
    found = deviations_of(covariance)
    assert found.T @ found == pytest.approx(covariance)
    assert deviations_of(np.zeros((3, 3))).shape == (0, 3)


def test_residuals_that_resemble_their_neighbours_are_worth_less():
    random = np.random.default_rng(1)
    white = random.normal(size=400)
    wandering = np.convolve(white, np.ones(8), mode="valid")
    assert dependence(white) == 1.0
    assert dependence(-wandering * 3.0) > 5.0
    assert dependence(np.tile([1.0, -1.0], 50)) == 1.0
