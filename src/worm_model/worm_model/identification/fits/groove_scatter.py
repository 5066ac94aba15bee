# SPDX-License-Identifier: Apache-2.0
"""Stage 4, continued: differences between grooves, and their effect on the intervals of η and p_sw.

All runs pass the same few ridges. Uneven grooves therefore cause the same deviation of x1 in every run, which a
bootstrap over runs would not detect. Each groove has a deviation of its threshold and of its stiffness for each module.
The standard deviations of these deviations, the scatter, are estimated from the data by expectation maximisation. For
even grooves the scatter vanishes. η and p_sw are means over the grooves. Their intervals follow from profiles, in which
all deviations are fitted again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from worm_model.arrays import Array
from worm_model.identification.fits import locomotion
from worm_model.identification.fits.block_least_squares import (
    Problem,
    Quantity,
    Solution,
    evaluate,
    normal_equations,
    prior_cost,
    solve,
    with_fixed,
)
from worm_model.parameters import Parameters
from worm_model.simulation.kernel.grooves import GROOVE_COLUMNS, STIFFNESS, THRESHOLD

ROWS = 10  # number of grooves in the table of a module; most of them lie ahead of its start
MEANS = 6  # number of shared parameters before the deviations
# Pairs of values for threshold (m) and relative stiffness (1)
FIRST_SCATTER = (1e-4, 0.02)  # start of the search for the scatter
LEAST_SCATTER = (1e-6, 1e-4)  # lower bound of the scatter
STEPS = (3e-5, 0.01)  # steps of the numerical derivatives with respect to the deviations
SCANNED = np.linspace(-6e-4, 6e-4, 13)  # m, tested deviations of a threshold
ROUNDS = 4  # number of times that fit and scatter are computed alternately
INNER_ROUNDS = 300  # iterations of expectation maximisation in each of these rounds


class Scatter(NamedTuple):
    """Standard deviations of the grooves' ``threshold`` in m and relative ``stiffness``, by column of the tables."""

    threshold: float
    stiffness: float


@dataclass(frozen=True)
class GrooveFit:
    """``solution`` of a ``problem`` with deviations of the grooves, which have a ``scatter``.

    ``parameters`` are the given values of all parameters that the problem does not contain. The deviations are the last
    shared parameters. ``places`` (k, 3) contains the place of each deviation: the module (0 rear, 1 front), and row and
    column of its table in `worm_model.simulation.kernel.grooves`.
    """

    parameters: Parameters
    problem: Problem
    solution: Solution
    places: NDArray[np.int64]
    scatter: Scatter

    @property
    def means(self) -> Array:
        """(η, p_sw, rear and front dry friction, pitch, onset) of a `groove_problem`."""
        return self.solution.shared[:MEANS]

    @property
    def tables(self) -> tuple[Array, Array]:
        """Tables of grooves, see `tables_of`."""
        return tables_of(self.solution.shared[MEANS:], self.places)


def tables_of(deviations: Array, places: NDArray[np.int64]) -> tuple[Array, Array]:
    """Return the kernel's tables of grooves of the rear and of the front module."""
    tables = np.zeros((2, ROWS, GROOVE_COLUMNS))
    tables[tuple(places.T)] = deviations
    return tables[0], tables[1]


def groove_problem(
    traverses: Sequence[locomotion.Traverse],
    known: locomotion.Known,
    places: NDArray[np.int64],
    scatter: Scatter,
) -> Problem:
    """Return the problem of x1 with means and deviations; the scatter is the prior standard deviation."""
    worm = locomotion.worm_of(known.parameters)

    def residuals(run: int, values: Array, own: Array) -> Array:
        robot = locomotion.with_means(worm, values[:MEANS], own)
        return locomotion.x1_residuals(traverses[run], robot, *tables_of(values[MEANS:], places))

    half = 0.5 * known.parameters.pitch
    deviations = (
        Quantity(STEPS[THRESHOLD], -half, half, 0.0, scatter.threshold),
        Quantity(STEPS[STIFFNESS], -0.9, 9.0, 0.0, scatter.stiffness),
    )
    shared = [
        *locomotion.shared_quantities(known),
        *(deviations[column] for column in places[:, 2]),
    ]
    return Problem(residuals, shared, locomotion.own_quantities(traverses, known), jumps=True)


def fit_grooves(
    traverses: Sequence[locomotion.Traverse], known: locomotion.Known, start: Solution
) -> GrooveFit:
    """Estimate scatter, deviations and means, starting from a solution with even grooves."""
    scatter = Scatter(*FIRST_SCATTER)
    places = np.argwhere(np.ones((2, ROWS, GROOVE_COLUMNS)))  # all possible deviations
    places = places[_matters(groove_problem(traverses, known, places, scatter), start)]
    problem = groove_problem(traverses, known, places, scatter)
    shared = np.concatenate([start.shared, np.zeros(len(places))])
    own = start.own
    for _ in range(ROUNDS):
        solution = _scanned(problem, solve(problem, shared, own, iterations=4), places)
        shared, own = solution.shared, solution.own
        scatter = _learned_scatter(problem, solution, places, scatter)
        problem = groove_problem(traverses, known, places, scatter)
    solution = solve(problem, shared, own, iterations=6)
    return GrooveFit(known.parameters, problem, solution, places, scatter)


def given_fit(traverses: Sequence[locomotion.Traverse], known: locomotion.Known) -> GrooveFit:
    """Return the solution with the given parameters and even grooves, without a fit."""
    given = [getattr(known.parameters, key) for key in locomotion.SHARED[:-1]]
    shared = np.array([*given, locomotion.FIRST_ONSET])
    places, scatter = np.empty((0, 3), np.int64), Scatter(np.nan, np.nan)
    problem = groove_problem(traverses, known, places, scatter)
    solution = evaluate(problem, shared, locomotion.first_own(traverses))
    return GrooveFit(known.parameters, problem, solution, places, scatter)


def _scanned(problem: Problem, solution: Solution, places: NDArray[np.int64]) -> Solution:
    """Return the best solution after trying other thresholds of single grooves.

    The cost jumps at a threshold at which a switch just fails or just happens. Gradients do not show such a jump.
    """
    for entry in MEANS + np.flatnonzero(places[:, 2] == THRESHOLD):
        for value in SCANNED:
            moved = solution.shared.copy()
            moved[entry] = value
            trial = evaluate(problem, moved, solution.own)
            if trial.cost < solution.cost:
                solution = trial
    return solution


def _matters(problem: Problem, start: Solution) -> list[bool]:
    """Return for each deviation of a problem whether it affects the residuals: the runs pass its groove."""
    shared = np.concatenate([start.shared, np.zeros(len(problem.shared) - MEANS)])
    matters = []
    for entry in range(MEANS, shared.size):
        moved = shared.copy()
        moved[entry] += problem.shared[entry].step
        matters.append(
            any(
                not np.array_equal(problem.residuals(run, moved, start.own[run]), residuals)
                for run, residuals in enumerate(start.residuals)
            )
        )
    return matters


def _learned_scatter(
    problem: Problem, solution: Solution, places: NDArray[np.int64], scatter: Scatter
) -> Scatter:
    """Return the scatter by expectation maximisation on the problem linearised around the solution."""
    matrix, gradient = normal_equations(problem, solution)
    entries = [MEANS + np.flatnonzero(places[:, 2] == k) for k in (THRESHOLD, STIFFNESS)]
    spreads = list(scatter)
    pull = matrix @ solution.values - gradient
    for index, spread in zip(entries, spreads, strict=True):
        matrix[index, index] -= spread**-2
    for _ in range(INNER_ROUNDS):
        posterior = matrix.copy()
        for index, spread in zip(entries, spreads, strict=True):
            posterior[index, index] += spread**-2
        # deviations without any effect, such as a threshold that no run reaches
        idle = np.flatnonzero(np.diag(posterior) <= 0.0)
        posterior[idle, idle] = 1.0
        scale = 1.0 / np.sqrt(np.diag(posterior))
        covariance = np.linalg.inv(posterior * np.outer(scale, scale)) * np.outer(scale, scale)
        mean, variance = covariance @ pull, np.diag(covariance)
        spreads = [
            max(float(np.sqrt(np.mean(mean[index] ** 2 + variance[index]))), least)
            if index.size
            else least
            for index, least in zip(entries, LEAST_SCATTER, strict=True)
        ]
    return Scatter(*spreads)


def held(fit: GrooveFit, entry: int, value: float) -> Solution:
    """Return the solution with the mean ``entry`` fixed at a value and all other parameters fitted again."""
    shared = np.delete(fit.solution.shared, entry)
    problem = with_fixed(fit.problem, entry, value)
    found = solve(problem, shared, fit.solution.own, iterations=8)
    prior = prior_cost([value], [fit.problem.shared[entry]])
    return replace(found, shared=np.insert(found.shared, entry, value), cost=found.cost + prior)
