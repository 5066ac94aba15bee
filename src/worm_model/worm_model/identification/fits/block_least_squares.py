# SPDX-License-Identifier: Apache-2.0
"""Robust least squares over several runs, with shared parameters and nuisance parameters of each run.

Levenberg–Marquardt with Huber weights on structured normal equations: a run's residuals depend only on the shared
parameters and on its own nuisance parameters. `scipy.optimize.least_squares` takes twenty times as long, and a
bootstrap needs hundreds of fits.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from worm_model.arrays import Array

Residuals = Callable[[int, Array, Array], Array]

# Residual, in units of the noise, beyond which its cost is linear instead of quadratic
HUBER = 2.5
MOST_ITERATIONS = 40
MOST_DAMPING = 1e6  # damping at which the search for a step that lowers the cost ends
NARROW = 0.15  # factor on the derivative steps, applied when the full steps make no progress
TOLERANCE = 1e-6  # relative decrease of the cost at which a fit has converged


class Quantity(NamedTuple):
    """Parameter: step of its numerical derivative, bounds ``low`` and ``high``, and a normal prior.

    ``spread`` is the prior's standard deviation around ``centre``; infinite without a prior.
    """

    step: float
    low: float = -np.inf
    high: float = np.inf
    centre: float = 0.0
    spread: float = np.inf


class Table(NamedTuple):
    """Fields of several quantities as arrays, each of shape (n,)."""

    step: Array
    low: Array
    high: Array
    centre: Array
    spread: Array

    def at(self, entries: NDArray[np.intp]) -> Table:
        """Return the fields of the quantities with these indices."""
        return Table(*(field[entries] for field in self))


@dataclass(frozen=True)
class Problem:
    """Least-squares problem.

    Attributes:
        residuals: function (run, shared (s,), own (q,)) that returns residuals in units of the noise.
        shared: shared parameters.
        own: nuisance parameters of each run.
        jumps: True if the residuals are discontinuous, so that a derivative over a wide step may be useless.
    """

    residuals: Residuals
    shared: Sequence[Quantity]
    own: Sequence[Sequence[Quantity]]
    jumps: bool = False

    @cached_property
    def table(self) -> Table:
        """All quantities: the shared ones, then those of each run."""
        return Table(*np.array([*self.shared, *(q for row in self.own for q in row)]).T)

    @cached_property
    def entries(self) -> list[NDArray[np.intp]]:
        """Indices in the table of the quantities on which each run depends: the shared ones, then its own."""
        count, first = np.arange(len(self.shared)), len(self.shared)
        indices = []
        for row in self.own:
            indices.append(np.append(count, np.arange(first, first + len(row))))
            first += len(row)
        return indices


@dataclass(frozen=True)
class Solution:
    """Solution: ``shared`` (s,), ``own`` (runs, q), the ``residuals`` of each run, and the robust ``cost``."""

    shared: Array
    own: Array
    residuals: tuple[Array, ...]
    cost: float

    @property
    def values(self) -> Array:
        """All parameters, in the order of `Problem.table`."""
        return np.concatenate([self.shared, self.own.ravel()])


def with_fixed(problem: Problem, entry: int, value: float) -> Problem:
    """Return the problem without the shared parameter ``entry``, which is fixed at a value."""
    held = np.array([value])

    def residuals(run: int, shared: Array, own: Array) -> Array:
        return problem.residuals(run, np.concatenate([shared[:entry], held, shared[entry:]]), own)

    shared = [quantity for k, quantity in enumerate(problem.shared) if k != entry]
    return replace(problem, residuals=residuals, shared=shared)


def of_runs(problem: Problem, runs: Sequence[int]) -> Problem:
    """Return the problem of some of the runs."""

    def residuals(run: int, shared: Array, own: Array) -> Array:
        return problem.residuals(runs[run], shared, own)

    return replace(problem, residuals=residuals, own=[problem.own[run] for run in runs])


def remembering(problem: Problem, most: int) -> Problem:
    """Return the problem with residuals that are not computed again for any of the last ``most`` arguments.

    It pays for fits to different runs that start from the same solution.
    """

    @lru_cache(most)
    def known(run: int, shared: bytes, own: bytes) -> Array:
        return problem.residuals(run, np.frombuffer(shared), np.frombuffer(own))

    def residuals(run: int, shared: Array, own: Array) -> Array:
        return known(run, shared.tobytes(), own.tobytes())

    return replace(problem, residuals=residuals)


def solve(
    problem: Problem,
    shared: Array,
    own: Array,
    weights: Sequence[Array] | None = None,
    iterations: int = MOST_ITERATIONS,
) -> Solution:
    """Return the local minimum near the start values ``shared`` (s,) and ``own`` (runs, q).

    ``weights`` contains the weights of each run's samples; by default all are 1. After ``iterations`` steps, the result
    is the best solution found until then.
    """
    state = evaluate(problem, np.array(shared, float), np.array(own, float), weights)
    damping, width = 1e-3, 1.0
    for _ in range(iterations):
        matrix, gradient = normal_equations(problem, state, weights, width)
        trial, damping = _best_step(problem, state, matrix, gradient, damping, weights)
        gained = state.cost - trial.cost
        state = trial
        if gained <= TOLERANCE * state.cost:
            if width < 1.0 or not problem.jumps:
                break
            width = NARROW  # a discontinuity may lie between the points of the differences
    return state


def _best_step(
    problem: Problem,
    state: Solution,
    matrix: Array,
    gradient: Array,
    damping: float,
    weights: Sequence[Array] | None,
) -> tuple[Solution, float]:
    """Return the state after a step that lowers the cost, and the next damping; the same state if no step does.

    A parameter is fixed if it is at a bound and the step would cross this bound.
    """
    free = _free(problem, state, gradient)
    part, slope = matrix[free[:, np.newaxis], free], gradient[free]
    scale = np.diag(np.diag(part) + 1e-12)
    step = np.zeros(gradient.size)
    while damping < MOST_DAMPING:
        step[free] = -np.linalg.solve(part + damping * scale, slope)
        trial = evaluate(problem, *_moved(problem, state, step), weights)
        if trial.cost < state.cost:
            return trial, max(damping / 8.0, 1e-6)
        damping *= 8.0
    return state, 1e-3


def _free(problem: Problem, state: Solution, gradient: Array) -> NDArray[np.intp]:
    values, table = state.values, problem.table
    held = ((values <= table.low) & (gradient > 0.0)) | ((values >= table.high) & (gradient < 0.0))
    return np.flatnonzero(~held)


def _moved(problem: Problem, state: Solution, step: Array) -> tuple[Array, Array]:
    values = np.clip(state.values + step, problem.table.low, problem.table.high)
    count = len(problem.shared)
    return values[:count], values[count:].reshape(state.own.shape)


def evaluate(
    problem: Problem, shared: Array, own: Array, weights: Sequence[Array] | None = None
) -> Solution:
    """Return residuals and cost at given parameters."""
    residuals = tuple(problem.residuals(run, shared, own[run]) for run in range(len(problem.own)))
    costs = [_huber(r) for r in residuals]
    if weights is not None:
        costs = [weight * cost for weight, cost in zip(weights, costs, strict=True)]
    cost = sum(float(cost.sum()) for cost in costs)
    cost += prior_cost(shared.tolist(), problem.shared)
    cost += sum(prior_cost(row, q) for row, q in zip(own.tolist(), problem.own, strict=True))
    return Solution(shared, own, residuals, cost)


def _huber(residuals: Array) -> Array:
    size = np.abs(residuals)
    return np.where(size <= HUBER, size**2, 2.0 * HUBER * size - HUBER**2)


def prior_cost(values: Sequence[float], quantities: Sequence[Quantity]) -> float:
    """Return the cost of the deviations from the priors."""
    return sum(
        ((value - quantity.centre) / quantity.spread) ** 2
        for value, quantity in zip(values, quantities, strict=True)
    )


def normal_equations(
    problem: Problem, state: Solution, weights: Sequence[Array] | None = None, width: float = 1.0
) -> tuple[Array, Array]:
    """Return the matrix of the normal equations and the gradient of half the cost, both including the priors.

    Shared parameters come first, then the nuisance parameters of each run. ``width`` multiplies the steps of the
    numerical derivatives.
    """
    values, table = state.values, problem.table
    matrix, gradient = np.zeros((values.size, values.size)), np.zeros(values.size)
    for run, residuals in enumerate(state.residuals):
        jacobian = _jacobian(problem, state, run, width)
        weight = np.minimum(1.0, HUBER / np.maximum(np.abs(residuals), 1e-12))
        if weights is not None:
            weight = weight * weights[run]
        entries = problem.entries[run]
        weighted = jacobian * weight[:, np.newaxis]
        matrix[entries[:, np.newaxis], entries] += weighted.T @ jacobian
        gradient[entries] += weighted.T @ residuals
    precision = table.spread**-2.0
    matrix += np.diag(precision)
    return matrix, gradient + precision * (values - table.centre)


def inverse(matrix: Array) -> Array:
    """Return the pseudo-inverse of a symmetric matrix with entries of very different magnitude."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    unit = np.outer(scale, scale)
    inverted: Array = np.linalg.pinv(matrix * unit, hermitian=True) * unit
    return inverted


def _jacobian(problem: Problem, state: Solution, run: int, width: float) -> Array:
    """Return the Jacobian of a run's residuals by shared and nuisance parameters, by central differences.

    One-sided differences are not accurate enough: almost collinear parameters (η and a stiffness common to all grooves)
    would appear separable because their curvatures differ. At a bound the difference is one-sided.
    """
    values, table = (
        np.concatenate([state.shared, state.own[run]]),
        problem.table.at(problem.entries[run]),
    )
    low = np.maximum(values - width * table.step, table.low)
    high = np.minimum(values + width * table.step, table.high)
    count = len(problem.shared)

    def at(entry: int, value: float) -> Array:
        if value == values[entry]:  # at a bound
            return state.residuals[run]
        moved = values.copy()
        moved[entry] = value
        return problem.residuals(run, moved[:count], moved[count:])

    jacobian = np.empty((state.residuals[run].size, values.size))
    for k in range(values.size):
        jacobian[:, k] = (at(k, high[k]) - at(k, low[k])) / (high[k] - low[k])
    return jacobian


def own_deviations(problem: Problem, solution: Solution, entry: int) -> Array:
    """Return the standard deviations, shape (runs,), of the nuisance parameter ``entry`` of each run, in its unit.

    They follow from the curvature of the cost, with all other parameters free. The cost must be continuous in the
    nuisance parameter.
    """
    matrix, _ = normal_equations(problem, solution)
    own = solution.own.shape[1]
    deviation: Array = np.sqrt(np.diag(inverse(matrix))[len(problem.shared) + entry :: own])
    return deviation
