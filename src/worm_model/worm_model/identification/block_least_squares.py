# SPDX-License-Identifier: Apache-2.0
"""Robust least squares over several runs: shared parameters, and nuisances that each run has for itself.

Levenberg–Marquardt on normal equations whose structure is known (a run's residuals depend on the shared
parameters and on that run's nuisances only), with Huber weights. `scipy.optimize.least_squares` does the
same twenty times slower, and a bootstrap needs hundreds of fits.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from worm_model.arrays import Array

Residuals = Callable[[int, Array, Array], Array]

HUBER = 2.5  # scales beyond which a residual counts by its size, not by its square
MOST_ITERATIONS = 40
MOST_DAMPING = 1e6
NARROW = 0.15  # of the derivatives' steps, once the wide ones lead no further
TOLD = 0.5  # of what was assumed before the data: a deviation above it is mostly the assumption
TOLERANCE = 1e-6  # relative decrease of the cost at which a fit has arrived


@dataclass(frozen=True)
class Quantity:
    """A shared parameter or a nuisance: ``step`` of its numerical derivative, bounds, and a normal prior.

    ``spread`` is the prior's standard deviation around ``centre``; infinite without a prior.
    """

    step: float
    low: float = -np.inf
    high: float = np.inf
    centre: float = 0.0
    spread: float = np.inf


@dataclass(frozen=True)
class Problem:
    """``residuals(run, shared (s,), own (q,))`` in units of the noise; ``own`` holds a row of q nuisances a run.

    ``jumps`` says that the residuals may jump, so that a derivative over a wide step may be worth nothing.
    """

    residuals: Residuals
    shared: Sequence[Quantity]
    own: Sequence[Sequence[Quantity]]
    jumps: bool = False


@dataclass(frozen=True)
class Solution:
    """``shared`` (s,), ``own`` (runs, q), the ``residuals`` of every run, and the robust ``cost``."""

    shared: Array
    own: Array
    residuals: tuple[Array, ...]
    cost: float


def with_fixed(problem: Problem, entry: int, value: float) -> Problem:
    """The problem without a shared parameter, which is held at a value."""

    def residuals(run: int, shared: Array, own: Array) -> Array:
        return problem.residuals(run, np.insert(shared, entry, value), own)

    shared = [quantity for k, quantity in enumerate(problem.shared) if k != entry]
    return replace(problem, residuals=residuals, shared=shared)


def solve(
    problem: Problem,
    shared: Array,
    own: Array,
    weights: Sequence[Array] | None = None,
    iterations: int = MOST_ITERATIONS,
) -> Solution:
    """The minimum next to a start; ``weights`` are those of the samples of every run, by default 1."""
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
            width = NARROW  # perhaps a jump lies between the points of the differences
    return state


def _best_step(
    problem: Problem,
    state: Solution,
    matrix: Array,
    gradient: Array,
    damping: float,
    weights: Sequence[Array] | None,
) -> tuple[Solution, float]:
    """(state after a step that lowers the cost, next damping); the same state if there is none.

    What stands at a bound and is pushed against it stays there.
    """
    free = _free(problem, state, gradient)
    part = matrix[np.ix_(free, free)]
    step = np.zeros(gradient.size)
    while damping < MOST_DAMPING:
        damped = part + damping * np.diag(np.diag(part) + 1e-12)
        step[free] = -np.linalg.solve(damped, gradient[free])
        trial = evaluate(problem, *_moved(problem, state, step), weights)
        if trial.cost < state.cost:
            return trial, max(damping / 8.0, 1e-6)
        damping *= 8.0
    return state, 1e-3


def _free(problem: Problem, state: Solution, gradient: Array) -> NDArray[np.intp]:
    quantities = [*problem.shared, *(q for row in problem.own for q in row)]
    values = np.concatenate([state.shared, state.own.ravel()])
    low = np.array([quantity.low for quantity in quantities])
    high = np.array([quantity.high for quantity in quantities])
    held = ((values <= low) & (gradient > 0.0)) | ((values >= high) & (gradient < 0.0))
    return np.flatnonzero(~held)


def _moved(problem: Problem, state: Solution, step: Array) -> tuple[Array, Array]:
    count = len(problem.shared)
    shared = _clipped(state.shared + step[:count], problem.shared)
    own = state.own + step[count:].reshape(state.own.shape)
    rows = [_clipped(row, quantities) for row, quantities in zip(own, problem.own, strict=True)]
    return shared, np.array(rows).reshape(state.own.shape)


def _clipped(values: Array, quantities: Sequence[Quantity]) -> Array:
    low = [quantity.low for quantity in quantities]
    high = [quantity.high for quantity in quantities]
    return np.clip(values, low, high)


def evaluate(
    problem: Problem, shared: Array, own: Array, weights: Sequence[Array] | None = None
) -> Solution:
    """The state at given parameters."""
    residuals = tuple(problem.residuals(run, shared, own[run]) for run in range(len(problem.own)))
    cost = sum(
        float(np.sum(_huber(r) if weights is None else weights[run] * _huber(r)))
        for run, r in enumerate(residuals)
    )
    cost += prior_cost(shared, problem.shared)
    cost += sum(prior_cost(row, q) for row, q in zip(own, problem.own, strict=True))
    return Solution(shared, own, residuals, cost)


def _huber(residuals: Array) -> Array:
    size = np.abs(residuals)
    return np.where(size <= HUBER, size**2, 2.0 * HUBER * size - HUBER**2)


def prior_cost(values: Sequence[float] | Array, quantities: Sequence[Quantity]) -> float:
    """Of values that stray from the centres of their priors."""
    return sum(
        ((value - quantity.centre) / quantity.spread) ** 2
        for value, quantity in zip(values, quantities, strict=True)
    )


def normal_equations(
    problem: Problem, state: Solution, weights: Sequence[Array] | None = None, width: float = 1.0
) -> tuple[Array, Array]:
    """(matrix, gradient) of half the cost, shared parameters first, then run after run; priors included.

    ``width`` multiplies the steps of the numerical derivatives.
    """
    count, (runs, own_count) = len(problem.shared), state.own.shape
    size = count + runs * own_count
    matrix, gradient = np.zeros((size, size)), np.zeros(size)
    for run, residuals in enumerate(state.residuals):
        jacobian = _jacobian(problem, state, run, width)
        weight = np.minimum(1.0, HUBER / np.maximum(np.abs(residuals), 1e-12))
        if weights is not None:
            weight = weight * weights[run]
        columns = np.r_[:count, count + run * own_count : count + (run + 1) * own_count]
        weighted = jacobian * weight[:, np.newaxis]
        matrix[np.ix_(columns, columns)] += weighted.T @ jacobian
        gradient[columns] += weighted.T @ residuals
    quantities = [*problem.shared, *(q for row in problem.own for q in row)]
    values = np.concatenate([state.shared, state.own.ravel()])
    precision = np.array([q.spread**-2.0 for q in quantities])
    centre = np.array([q.centre for q in quantities])
    matrix += np.diag(precision)
    return matrix, gradient + precision * (values - centre)


def inverse(matrix: Array) -> Array:
    """Of a symmetric matrix whose entries are of very different sizes."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    unit = np.outer(scale, scale)
    inverted: Array = np.linalg.pinv(matrix * unit, hermitian=True) * unit
    return inverted


def _jacobian(problem: Problem, state: Solution, run: int, width: float) -> Array:
    """Of a run's residuals by the shared parameters and its own nuisances, by central differences.

    One-sided ones would not do: parameters that can hardly be told apart (η and a stiffness that all grooves
    share) would look as if they could, by their curvatures' difference. At a bound there is no choice.
    """
    values = np.concatenate([state.shared, state.own[run]])
    quantities = [*problem.shared, *problem.own[run]]
    count = len(problem.shared)
    columns = np.empty((state.residuals[run].size, values.size))
    for k, quantity in enumerate(quantities):
        sides = values.copy(), values.copy()
        sides[0][k] = max(values[k] - width * quantity.step, quantity.low)
        sides[1][k] = min(values[k] + width * quantity.step, quantity.high)
        low, high = (problem.residuals(run, side[:count], side[count:]) for side in sides)
        columns[:, k] = (high - low) / (sides[1][k] - sides[0][k])
    return columns


def clock_deviations(
    problem: Problem, solution: Solution, entry: int, weights: Sequence[Array] | None = None
) -> Array:
    """(runs,) standard deviations in s of the nuisance ``entry`` of each run.

    From the curvature of the cost, which does not jump in an offset; all other parameters are open.
    """
    matrix, _ = normal_equations(problem, solution, weights)
    own = solution.own.shape[1]
    deviation: Array = np.sqrt(np.diag(inverse(matrix))[len(problem.shared) + entry :: own])
    return deviation


def told(deviation: Array, prior: float) -> Array:
    """The deviations, NaN where the data tell hardly more than the ``prior`` one."""
    return np.where(deviation <= TOLD * prior, deviation, np.nan)
