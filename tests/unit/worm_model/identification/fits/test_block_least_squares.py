# SPDX-License-Identifier: Apache-2.0
"""Robust least squares over runs."""

import numpy as np
import pytest

from worm_model.identification.fits.block_least_squares import (
    Problem,
    Quantity,
    normal_equations,
    solve,
    with_fixed,
)

RUNS, SAMPLES = 3, 40


def lines(noise=0.0, seed=0, prior=np.inf):
    """Return runs that share a slope and a curvature and have an offset each."""
    random = np.random.default_rng(seed)
    x = np.linspace(0.0, 1.0, SAMPLES)
    offsets = np.array([0.5, -1.0, 2.0])
    y = [o + 3.0 * x - 2.0 * x**2 + random.normal(0.0, noise, SAMPLES) for o in offsets]

    def residuals(run, shared, own):
        return y[run] - (own[0] + shared[0] * x + shared[1] * x**2)

    own = [(Quantity(1e-3, centre=0.0, spread=prior),)] * RUNS
    return Problem(residuals, [Quantity(1e-3), Quantity(1e-3)], own), x, y


def test_linear_problems_are_solved_as_numpy_does():
    problem, x, y = lines(noise=0.01)
    solution = solve(problem, np.zeros(2), np.zeros((RUNS, 1)))
    design = np.zeros((RUNS * SAMPLES, 5))
    for run in range(RUNS):
        rows = slice(run * SAMPLES, (run + 1) * SAMPLES)
        design[rows, 0], design[rows, 1], design[rows, 2 + run] = x, x**2, 1.0
    expected, *_ = np.linalg.lstsq(design, np.concatenate(y), rcond=None)
    assert np.concatenate([solution.shared, solution.own.ravel()]) == pytest.approx(
        expected, abs=1e-6
    )
    matrix, gradient = normal_equations(problem, solution)
    assert matrix == pytest.approx(design.T @ design, rel=1e-6)
    assert np.abs(gradient).max() < 1e-5


def test_a_gross_outlier_pulls_by_a_bounded_force():
    problem, _, y = lines(noise=0.01)
    plain = solve(problem, np.zeros(2), np.zeros((RUNS, 1))).shared
    y[0][7] += 1e6
    spoilt = solve(problem, np.zeros(2), np.zeros((RUNS, 1))).shared
    assert spoilt == pytest.approx(plain, abs=1.0)


def test_weights_leave_samples_out():
    problem, _, y = lines()
    y[1][:] += np.random.default_rng(1).normal(0.0, 5.0, SAMPLES)
    weights = [np.ones(SAMPLES), np.zeros(SAMPLES), np.ones(SAMPLES)]
    solution = solve(problem, np.zeros(2), np.zeros((RUNS, 1)), weights)
    assert solution.shared == pytest.approx([3.0, -2.0], abs=1e-5)


def test_bounds_hold_and_a_held_parameter_stays():
    problem, _, _ = lines()
    bounded = Problem(problem.residuals, [Quantity(1e-3, high=2.5), Quantity(1e-3)], problem.own)
    assert solve(bounded, np.zeros(2), np.zeros((RUNS, 1))).shared[0] == pytest.approx(2.5)
    held = solve(with_fixed(problem, 0, 2.5), np.zeros(1), np.zeros((RUNS, 1)))
    assert held.shared == pytest.approx(
        solve(bounded, np.zeros(2), np.zeros((RUNS, 1))).shared[1:], abs=1e-4
    )


def test_a_tight_prior_wins_over_the_data():
    problem, _, _ = lines(prior=1e-6)
    solution = solve(problem, np.zeros(2), np.zeros((RUNS, 1)))
    assert np.abs(solution.own).max() < 1e-3
