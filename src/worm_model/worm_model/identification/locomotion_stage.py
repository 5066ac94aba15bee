# SPDX-License-Identifier: Apache-2.0
"""Stage 4, the fit of the motion: friction η, switching threshold p_sw and pitch, with intervals.

The intervals follow from profiles of the cost, because the cost jumps. For a profile, one parameter is moved away from
its best value and fixed, and all others are fitted again. The interval ends where the cost has risen to the 95 % level.
A small number of grooves (Student's t), correlated residuals and the uncertainty of the fin test widen the intervals.
The pitch is estimated with the given value as its prior, because the ridges that x1 passes determine it better than a
ruler does.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from worm_model.arrays import Array
from worm_model.identification.fin import KEYS as FIN
from worm_model.identification.fits import locomotion
from worm_model.identification.fits.block_least_squares import (
    Solution,
    inverse,
    normal_equations,
    solve,
    with_fixed,
)
from worm_model.identification.fits.estimate import (
    Estimate,
    follow_profile,
    if_identifiable,
    not_identifiable,
    quantile,
)
from worm_model.identification.fits.groove_scatter import (
    MEANS,
    GrooveFit,
    fit_grooves,
    given_fit,
    groove_problem,
    held,
)
from worm_model.parameters import PAPER
from worm_model.simulation.kernel.grooves import STIFFNESS, THRESHOLD
from worm_model.simulation.kernel.march import FORCE

Progress = Callable[[float], None]

FRICTION, SWITCHING, REAR_DRY, FRONT_DRY, PITCH, ONSET = range(6)  # entries of `GrooveFit.means`
USUAL_DRY = 0.3  # N, viscous friction of the paper's robot at 3.5 mm/s; see `if_identifiable`
SOUGHT = (FRICTION, SWITCHING, PITCH)  # means whose intervals follow from profiles
# First step of the search for an end of the interval, in addition to the effect of the scatter: N·s/m, m, m
FIRST_REACH = {FRICTION: 1.0, SWITCHING: 3e-5, PITCH: 5e-6}
# Column of the groove tables, by mean: the scatter of this column makes the mean uncertain.
SCATTERED = {FRICTION: STIFFNESS, SWITCHING: THRESHOLD}
LEAST_EIGENVALUE = 1e-9  # smaller eigenvalues of a correlation are rounding errors
# Half-width of the 95 % interval of a normal distribution, in standard deviations
NORMAL = quantile(np.inf)
LONGEST_MEMORY = 30  # largest lag of correlated residuals, in samples
# Another fit replaces the present one if its cost is lower by more than this times the inflation of the variances
BETTER = 0.5
# Iterations of the fit with changed fin values; it starts from the solution with the given fin values.
VARIANT_ITERATIONS = 10
MOST_RESTARTS = 8  # number of better fits found by the profiles after which there are no intervals
UNSETTLED = (
    "each fit of the motion found a better solution far from the previous one; a given value may be wrong (check the "
    "pitch first, then masses and lengths), runs may not have begun in the same grooves with straight fins, or markers "
    "were hidden for long"
)
UNEXPLAINED = (
    "no friction and threshold explain the motion of x1; the value is the given one; check that all runs show this "
    "worm in a corrugated pipe, from rest"
)


@dataclass(frozen=True)
class LocomotionResult:
    """Result of stage 4.

    Attributes:
        viscous_friction, switching_threshold: estimates, N·s/m and m.
        rear_dry_friction, front_dry_friction, pitch: estimates, N, N and m.
        inflation: factor by which large or correlated residuals increase the variances, see `variance_inflation`.
        correlation: correlation of (η, p_sw, rear and front dry friction, pitch, onset), shape (6, 6).
        fit: the fit with all nuisance parameters.
        variants: fits with changed fin values. There is one for each independent direction of the fin values'
            covariance, with a change of one standard deviation. Empty if the covariance is unknown.
        stiffer: fit with η fixed one standard deviation above its estimate.
        without_dry_friction: (η, p_sw) of a local fit without dry friction, which starts from the best fit with even
            grooves and has its pitch and onset. Unlike in the paper's J_loc, large residuals have less weight (Huber),
            and L0 and the pose at rest of each run are fitted, too.
        trouble: reason why the estimates are not identifiable, if the fit as a whole failed; otherwise empty.
    """

    viscous_friction: Estimate
    switching_threshold: Estimate
    rear_dry_friction: Estimate
    front_dry_friction: Estimate
    pitch: Estimate
    inflation: float
    correlation: Array
    fit: GrooveFit
    variants: tuple[GrooveFit, ...]
    stiffer: GrooveFit
    without_dry_friction: tuple[float, float]
    trouble: str

    @property
    def onset(self) -> float:
        """How the modules share the first rate of ΔL, see `simulation.kernel.whole_run.run_from_rest`."""
        return float(self.fit.means[ONSET])

    @property
    def initial_length(self) -> Array:
        """L0 of each run, m, shape (runs,)."""
        return self.fit.solution.own[:, 0]


def identify_locomotion(
    traverses: Sequence[locomotion.Traverse],
    known: locomotion.Known,
    fin_covariance: Array | None = None,
    progress: Progress = lambda _: None,
) -> LocomotionResult:
    """Estimate η, p_sw, the dry friction of both modules and the pitch from all runs.

    ``known`` contains the given parameters and the uncertainty of the given pitch. ``fin_covariance`` (3, 3) is that of
    clearance (m), engaged and disengaged stiffness (N/m). Without it, the intervals are valid only for exact fin
    parameters. If no fit explains the motion, or if the profiles repeatedly find a better fit, the estimates are not
    identifiable.
    """
    valleys = locomotion.search(traverses, known, lambda done: progress(0.3 * done))
    start = locomotion.find_locomotion(traverses, known, valleys)
    if locomotion.is_lost(start):
        return _unexplained(traverses, known)
    plain = _without_dry_friction(traverses, known, start)
    fit = fit_grooves(traverses, known, start)
    progress(0.5)
    intervals: list[tuple[float, float]] = []
    for _ in range(MOST_RESTARTS):
        inflation = variance_inflation(fit.solution)
        intervals, better = _profiles(fit, inflation)
        if better is None:
            break
        fit = replace(fit, solution=better)
    trouble = "" if intervals else UNSETTLED
    progress(0.9)
    variants = _variants(traverses, known, fit, fin_covariance)
    matrix, _ = normal_equations(fit.problem, fit.solution)
    covariance = inverse(matrix)[:MEANS, :MEANS] * inflation
    deviation = np.sqrt(np.maximum(np.diag(covariance), 1e-30))
    friction, threshold, pitch = (
        _estimate(fit, entry, interval, variants)
        for entry, interval in zip(SOUGHT, intervals or [(-np.inf, np.inf)] * 3, strict=True)
    )
    one_deviation = friction.spread / NORMAL if np.isfinite(friction.spread) else 0.0
    stiffer = held(fit, FRICTION, float(fit.means[FRICTION]) + one_deviation)
    progress(1.0)
    return LocomotionResult(
        viscous_friction=if_identifiable(friction, PAPER.viscous_friction, trouble),
        switching_threshold=if_identifiable(threshold, PAPER.switching_threshold, trouble),
        rear_dry_friction=_dry_estimate(fit, REAR_DRY, deviation[REAR_DRY], variants),
        front_dry_friction=_dry_estimate(fit, FRONT_DRY, deviation[FRONT_DRY], variants),
        pitch=if_identifiable(pitch, note=trouble),
        inflation=inflation,
        correlation=covariance / np.outer(deviation, deviation),
        fit=fit,
        variants=variants,
        stiffer=replace(fit, solution=stiffer),
        without_dry_friction=(float(plain[0]), float(plain[1])),
        trouble=trouble,
    )


def _unexplained(
    traverses: Sequence[locomotion.Traverse], known: locomotion.Known
) -> LocomotionResult:
    """Return the result of runs that no friction and threshold explain, with the given values."""
    fit = given_fit(traverses, known)
    friction, threshold, rear_dry, front_dry, pitch = (
        not_identifiable(float(value), UNEXPLAINED) for value in fit.means[:ONSET]
    )
    return LocomotionResult(
        friction,
        threshold,
        rear_dry,
        front_dry,
        pitch,
        inflation=float("inf"),
        correlation=np.full((MEANS, MEANS), np.nan),
        fit=fit,
        variants=(),
        stiffer=fit,
        without_dry_friction=(float("nan"), float("nan")),
        trouble=UNEXPLAINED,
    )


def _dry_estimate(
    fit: GrooveFit, entry: int, deviation: float, variants: Sequence[GrooveFit]
) -> Estimate:
    """Return the estimate of a dry friction.

    Its interval follows from the curvature of the cost and the fin test's uncertainty, and does not extend below 0.
    """
    value = float(fit.means[entry])
    reach = float(np.hypot(NORMAL * deviation, _from_reference(fit, entry, variants)))
    return if_identifiable(Estimate(value, max(value - reach, 0.0), value + reach), USUAL_DRY)


def _from_reference(fit: GrooveFit, entry: int, variants: Sequence[GrooveFit]) -> float:
    """Return the 95 % half-width of a mean that is due to the fin test's uncertainty, in the mean's unit."""
    return NORMAL * float(np.linalg.norm([v.means[entry] - fit.means[entry] for v in variants]))


def holding_forces(
    traverses: Sequence[locomotion.Traverse], rows: Sequence[int], fit: GrooveFit
) -> tuple[Array, ...]:
    """Return the force H of the runs ``rows``, in N, at the times of each run's measured length, shape (n,).

    For H see `worm_model.identification.fits.energy`.
    """
    forces = []
    robot = locomotion.worm_of(fit.parameters)
    for row in rows:
        worm = locomotion.with_means(robot, fit.means, fit.solution.own[row])
        times = traverses[row].length.time
        samples = locomotion.follow(traverses[row], worm, times, *fit.tables)
        assert samples is not None, "the fitted motion switches endlessly"
        forces.append(samples[:, FORCE])
    return tuple(forces)


def variance_inflation(solution: Solution) -> float:
    """Return the factor by which large or correlated residuals increase the variances of a fit, at least 1."""
    power, memory = 0.0, 0.0
    for residuals in solution.residuals:
        r = np.clip(residuals, -5.0, 5.0)
        power += float(np.sum(r * r))
        for lag in range(1, min(LONGEST_MEMORY, r.size)):
            memory += 2.0 * float(np.sum(r[lag:] * r[:-lag])) * (1.0 - lag / LONGEST_MEMORY)
    count = sum(residuals.size for residuals in solution.residuals)
    return max(1.0, power / count * (1.0 + memory / power))


def _profiles(
    fit: GrooveFit, inflation: float
) -> tuple[list[tuple[float, float]], Solution | None]:
    """Return the interval (low, high) of each mean of `SOUGHT`, and None.

    If a profile finds a solution with a lower cost, the result is an empty list and this solution.
    """
    rise = NORMAL**2 * inflation
    met: list[Solution] = []

    def end(entry: int, sign: float) -> float:
        def cost(value: float) -> float:
            solution = held(fit, entry, value)
            if solution.cost < fit.solution.cost - BETTER * inflation:
                met.append(solution)
                return rise  # end the search: the fit restarts from this solution
            return max(solution.cost - fit.solution.cost, 0.0)

        guess = NORMAL * _scattered(fit, entry) + FIRST_REACH[entry]
        value, bound = float(fit.means[entry]), fit.problem.shared[entry]
        reach = abs((bound.high if sign > 0.0 else bound.low) - value)
        return follow_profile(cost, value, rise, sign * guess, reach)

    ends = []
    for entry in SOUGHT:
        ends.append((end(entry, -1.0), end(entry, 1.0)))
        if met:
            best = min(met, key=lambda solution: solution.cost)
            return [], solve(fit.problem, best.shared, best.own)
    return ends, None


def _scattered(fit: GrooveFit, entry: int) -> float:
    """Return the standard deviation of a mean that is due to the scatter of the grooves, in the mean's unit."""
    if entry not in SCATTERED:
        return 0.0
    column = SCATTERED[entry]
    count = max(int(np.sum(fit.places[:, 2] == column)), 1)
    unit = float(fit.means[FRICTION]) if entry == FRICTION else 1.0
    return unit * fit.scatter[column] / float(np.sqrt(count))


def _estimate(
    fit: GrooveFit,
    entry: int,
    interval: tuple[float, float],
    variants: Sequence[GrooveFit],
) -> Estimate:
    """Return the estimate of a mean from the ``interval`` of its profile.

    The interval is widened by Student's t, for few grooves, and by the uncertainty of the fin test.
    """
    value = float(fit.means[entry])
    widening = 1.0
    if entry in SCATTERED:
        grooves = int(np.sum(fit.places[:, 2] == SCATTERED[entry]))
        deviation = 0.5 * (interval[1] - interval[0]) / NORMAL
        share = min((_scattered(fit, entry) / deviation) ** 2, 1.0)
        widening = quantile((grooves - 1) / max(share, 1e-3) ** 2) / NORMAL
    from_reference = _from_reference(fit, entry, variants)
    low, high = (float(np.hypot((end - value) * widening, from_reference)) for end in interval)
    return Estimate(value, value - low, value + high)


def _variants(
    traverses: Sequence[locomotion.Traverse],
    known: locomotion.Known,
    fit: GrooveFit,
    fin_covariance: Array | None,
) -> tuple[GrooveFit, ...]:
    if fin_covariance is None:
        return ()

    def variant(direction: Array) -> GrooveFit:
        given = known.parameters
        moved = {key: getattr(given, key) + step for key, step in zip(FIN, direction, strict=True)}
        parameters = given.replace(**moved)
        changed = replace(known, parameters=parameters)
        problem = groove_problem(traverses, changed, fit.places, fit.scatter)
        best = solve(problem, fit.solution.shared, fit.solution.own, iterations=VARIANT_ITERATIONS)
        return replace(fit, parameters=parameters, problem=problem, solution=best)

    return tuple(map(variant, deviations_of(fin_covariance)))


def deviations_of(covariance: Array) -> Array:
    """Return deviations (r, k) whose outer products add up to a covariance (k, k) of rank r.

    The deviations of an entry without variance, such as an exactly known value, are 0.
    """
    scale = np.sqrt(np.diag(covariance))
    unit = np.where(scale > 0.0, scale, 1.0)
    values, vectors = np.linalg.eigh(covariance / np.outer(unit, unit))
    kept = values > LEAST_EIGENVALUE
    deviations: Array = (vectors[:, kept] * np.sqrt(values[kept])).T * scale
    return deviations


def _without_dry_friction(
    traverses: Sequence[locomotion.Traverse], known: locomotion.Known, start: Solution
) -> Array:
    """Return (η, p_sw) of a fit without dry friction, with the pitch and the onset of the solution ``start``."""
    problem = with_fixed(
        locomotion.locomotion_problem(traverses, known), ONSET, start.shared[ONSET]
    )
    problem = with_fixed(problem, PITCH, start.shared[PITCH])
    frictionless = with_fixed(with_fixed(problem, FRONT_DRY, 0.0), REAR_DRY, 0.0)
    return solve(frictionless, start.shared[:2], start.own).shared
