# SPDX-License-Identifier: Apache-2.0
"""Stage 4 as a whole: search, grooves, and the intervals of η and p_sw.

The intervals are profiles, for the cost jumps: one value is held, all else is refitted, until the cost has risen by
what 95 % need. They are widened by Student's t where few grooves stand behind them, by what the residuals have
beyond white noise of the camera, and by the uncertainty that the fin test leaves.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from worm_model.identification.blocks import Solution, normal_equations, solve, with_fixed
from worm_model.identification.errors import IdentificationError
from worm_model.identification.estimate import Estimate, follow_profile, quantile
from worm_model.identification.grooves import (
    GrooveFit,
    fit_grooves,
    groove_problem,
    held,
    tables_of,
)
from worm_model.identification.locomotion import (
    Landscape,
    Traverse,
    find_locomotion,
    locomotion_problem,
    search,
    slide,
    with_values,
    worm_of,
)
from worm_model.kernel.dry_friction import HOLDING_FORCE, STIFFNESS, THRESHOLD, X1
from worm_model.parameters import Parameters

Array = NDArray[np.float64]
Progress = Callable[[float], None]

FRICTION, SWITCHING = 0, 1  # entries of the means
NORMAL = quantile(np.inf)
LONGEST_MEMORY = 30  # samples over which residuals may resemble each other
BETTER = 0.5  # by how much a refit must be better to take its place
MOST_RESTARTS = 3


@dataclass(frozen=True)
class FinKnowledge:
    """``values`` of (clearance m, engaged and disengaged stiffness N/m) and their ``covariance`` (3, 3)."""

    values: Array
    covariance: Array


@dataclass(frozen=True)
class LocomotionResult:
    """``viscous_friction`` N·s/m and ``switching_threshold`` m with intervals; the rest are nuisances and diagnostics.

    ``dry_friction`` (rear, front) N with ``dry_deviation`` their standard deviations; ``initial_length`` (runs,) m;
    ``residuals`` of each run in m; ``inflation`` of the variance for what is not white in them; ``correlation`` of
    (η, p_sw, rear, front dry friction); ``variants``: fits under a fin test that is one standard deviation off,
    one a direction of its covariance; ``stiffer``: a fit whose η is one standard deviation higher; ``as_printed``:
    (η, p_sw) that minimise J_loc as it is printed, without dry friction and with grooves that are alike.
    """

    viscous_friction: Estimate
    switching_threshold: Estimate
    dry_friction: tuple[float, float]
    dry_deviation: tuple[float, float]
    initial_length: Array
    residuals: tuple[Array, ...]
    inflation: float
    correlation: Array
    landscape: Landscape
    fit: GrooveFit
    variants: tuple[tuple[Parameters, GrooveFit], ...]
    stiffer: GrooveFit
    as_printed: tuple[float, float]


@dataclass(frozen=True)
class Motion:
    """Of a fit, at the times of a run's length: ``x1`` (n,) m and ``holding`` (n,) N of the rear module."""

    x1: Array
    holding: Array


def identify_locomotion(
    traverses: Sequence[Traverse],
    parameters: Parameters,
    fin: FinKnowledge | None = None,
    progress: Progress = lambda _: None,
) -> LocomotionResult:
    """η and p_sw of all runs, the other ``parameters`` given; ``fin`` tells how well its three are known.

    Without it the intervals hold under the given fins alone. Raises `IdentificationError` if the fit
    does not settle.
    """
    landscape = search(traverses, parameters, lambda done: progress(0.3 * done))
    start = find_locomotion(traverses, parameters, landscape)
    problem = locomotion_problem(traverses, parameters)
    frictionless = with_fixed(with_fixed(problem, 3, 0.0), 2, 0.0)
    plain = solve(frictionless, start.shared[:2], start.own).shared
    fit = fit_grooves(traverses, parameters, start)
    progress(0.5)
    inflation = _inflation(traverses, fit.solution)
    for _ in range(MOST_RESTARTS):
        intervals, better = _profiles(traverses, parameters, fit, inflation)
        if better is None:
            break
        fit = replace(fit, solution=better)
    else:
        raise IdentificationError(
            "viscous_friction, switching_threshold: the fit kept finding a better solution far from the last, so "
            "that no interval holds: leave out runs whose markers were hidden for long, or add runs"
        )
    progress(0.9)
    variants = _variants(traverses, parameters, fit, fin)
    matrix, _ = normal_equations(
        groove_problem(traverses, parameters, fit.places, fit.scatter), fit.solution
    )
    covariance = np.linalg.pinv(matrix, hermitian=True)[:4, :4] * inflation
    deviation = np.sqrt(np.maximum(np.diag(covariance), 1e-30))
    friction, threshold = (
        _estimate(fit, entry, interval, variants)
        for entry, interval in zip((FRICTION, SWITCHING), intervals, strict=True)
    )
    progress(1.0)
    return LocomotionResult(
        viscous_friction=friction,
        switching_threshold=threshold,
        dry_friction=(float(fit.means[2]), float(fit.means[3])),
        dry_deviation=(float(deviation[2]), float(deviation[3])),
        initial_length=fit.solution.own[:, 0],
        residuals=tuple(
            r * t.noise for r, t in zip(fit.solution.residuals, traverses, strict=True)
        ),
        inflation=inflation,
        correlation=covariance / np.outer(deviation, deviation),
        landscape=landscape,
        fit=fit,
        variants=variants,
        stiffer=_stiffer(traverses, parameters, fit, friction),
        as_printed=(float(plain[0]), float(plain[1])),
    )


def refit(
    traverses: Sequence[Traverse],
    parameters: Parameters,
    like: GrooveFit,
    own: Array,
    iterations: int = 10,
) -> GrooveFit:
    """The fit to other runs or under other parameters, from a known one and with its scatter; ``own`` (runs, 1)."""
    problem = groove_problem(traverses, parameters, like.places, like.scatter)
    return replace(like, solution=solve(problem, like.solution.shared, own, iterations=iterations))


def motions(
    traverses: Sequence[Traverse], parameters: Parameters, fit: GrooveFit
) -> tuple[Motion, ...]:
    """What a fit says of every run."""
    grooves = tables_of(fit.solution.shared[4:], fit.places)
    found = []
    for traverse, own in zip(traverses, fit.solution.own, strict=True):
        worm = with_values(worm_of(parameters, traverse.direction), fit.means, own[0])
        samples = slide(traverse, worm, *grooves)
        assert samples is not None, "a fit moves without end"
        found.append(Motion(samples[:, X1], samples[:, HOLDING_FORCE]))
    return tuple(found)


def _inflation(traverses: Sequence[Traverse], solution: Solution) -> float:
    """By what the variance of white noise of the camera is to be multiplied, at least 1."""
    power, memory = 0.0, 0.0
    for residuals in solution.residuals:
        r = np.clip(residuals, -5.0, 5.0)
        power += float(np.sum(r * r))
        for lag in range(1, min(LONGEST_MEMORY, r.size)):
            memory += 2.0 * float(np.sum(r[lag:] * r[:-lag])) * (1.0 - lag / LONGEST_MEMORY)
    count = sum(t.time.size for t in traverses)
    return max(1.0, power / count * (1.0 + memory / power))


def _profiles(
    traverses: Sequence[Traverse], parameters: Parameters, fit: GrooveFit, inflation: float
) -> tuple[list[tuple[float, float]], Solution | None]:
    """((low, high) of η and of p_sw, a better solution that was met on the way or None)."""
    rise = NORMAL**2 * inflation
    met: list[Solution] = []

    def end(entry: int, sign: float) -> float:
        def cost(value: float) -> float:
            solution = held(traverses, parameters, fit, entry, value)
            if solution.cost < fit.solution.cost - BETTER:
                met.append(solution)
                return rise  # there is no point in going on
            return max(solution.cost - fit.solution.cost, 0.0)

        reach = NORMAL * _scattered(fit, entry) + (1.0, 3e-5)[entry]
        return follow_profile(cost, float(fit.means[entry]), rise, sign * reach)

    sides = [(entry, sign) for entry in (FRICTION, SWITCHING) for sign in (-1.0, 1.0)]
    with ThreadPoolExecutor() as pool:
        ends = list(pool.map(lambda side: end(*side), sides))
    if met:
        best = min(met, key=lambda solution: solution.cost)
        problem = groove_problem(traverses, parameters, fit.places, fit.scatter)
        return [], solve(problem, best.shared, best.own)
    return [(ends[0], ends[1]), (ends[2], ends[3])], None


def _scattered(fit: GrooveFit, entry: int) -> float:
    """Standard deviation of a mean for the scatter of the grooves alone, in the mean's unit."""
    column = STIFFNESS if entry == FRICTION else THRESHOLD
    count = max(int(np.sum(fit.places[:, 2] == column)), 1)
    unit = float(fit.means[FRICTION]) if entry == FRICTION else 1.0
    return unit * fit.scatter.of(column) / float(np.sqrt(count))


def _estimate(
    fit: GrooveFit,
    entry: int,
    interval: tuple[float, float],
    variants: tuple[tuple[Parameters, GrooveFit], ...],
) -> Estimate:
    """Widens a profile by Student's t for few grooves, and adds what the fin test leaves open."""
    value = float(fit.means[entry])
    column = STIFFNESS if entry == FRICTION else THRESHOLD
    grooves = int(np.sum(fit.places[:, 2] == column))
    deviation = 0.5 * (interval[1] - interval[0]) / NORMAL
    share = min((_scattered(fit, entry) / deviation) ** 2, 1.0)
    widening = quantile((grooves - 1) / max(share, 1e-3) ** 2) / NORMAL
    given = NORMAL * float(np.sqrt(sum((v.means[entry] - value) ** 2 for _, v in variants)))
    low, high = (float(np.hypot((end - value) * widening, given)) for end in interval)
    return Estimate(value, value - low, value + high)


def _variants(
    traverses: Sequence[Traverse], parameters: Parameters, fit: GrooveFit, fin: FinKnowledge | None
) -> tuple[tuple[Parameters, GrooveFit], ...]:
    if fin is None:
        return ()
    directions = np.linalg.cholesky(fin.covariance + 1e-12 * np.diag(np.diag(fin.covariance)))

    def variant(direction: Array) -> tuple[Parameters, GrooveFit]:
        clearance, engaged, disengaged = fin.values + direction
        moved = parameters.replace(
            clearance=clearance, engaged_stiffness=engaged, disengaged_stiffness=disengaged
        )
        return moved, refit(traverses, moved, fit, fit.solution.own)

    with ThreadPoolExecutor() as pool:
        return tuple(pool.map(variant, directions.T))


def _stiffer(
    traverses: Sequence[Traverse], parameters: Parameters, fit: GrooveFit, friction: Estimate
) -> GrooveFit:
    value = float(fit.means[FRICTION]) + friction.spread / NORMAL
    return replace(fit, solution=held(traverses, parameters, fit, FRICTION, value))
