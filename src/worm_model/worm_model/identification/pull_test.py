# SPDX-License-Identifier: Apache-2.0
"""Pull test: estimation of the load on the rear module of a known robot from x1, with the measured length as input.

Only the sum of both loads affects x1, so that the load of the front module must be known. Nuisance parameters are the
robot's parameters with their intervals as priors, the differences between grooves, L0, and the pose at rest. A
parameter without an interval counts as exact. Dry friction acts much like a load and therefore always has a prior.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from worm_model.arrays import Array
from worm_model.identification.data.identification_errors import IdentificationError
from worm_model.identification.data.strides import check_pitch
from worm_model.identification.fingerprint import code_version
from worm_model.identification.fits import locomotion
from worm_model.identification.fits.block_least_squares import Problem, Quantity, Solution, solve
from worm_model.identification.fits.estimate import Estimate, follow_profile
from worm_model.identification.fits.grooves import (
    GrooveFit,
    Scatter,
    deviation_quantities,
    fit_uneven,
    fixed_at,
    tables_of,
)
from worm_model.identification.inputs import Inputs
from worm_model.identification.locomotion_stage import (
    BETTER,
    NORMAL,
    USUAL_DRY,
    variance_inflation,
)
from worm_model.identification.reference_values import ReferenceValues
from worm_model.identification.run_selection import Run, fitted_runs
from worm_model.parameters import ParameterFile, Parameters
from worm_msgs.robot_parameters import ROWS

KEY = "rear_load"
#: step of the numerical derivative by parameter, in its unit
NUISANCES = {
    "viscous_friction": 1.0,
    "switching_threshold": 3e-5,
    "rear_dry_friction": 0.02,
    "front_dry_friction": 0.02,
    "pitch": 2e-6,
    "clearance": 3e-5,
    "engaged_stiffness": 10.0,
    "disengaged_stiffness": 4.0,
}
_PLACES = locomotion.places_of((KEY, *NUISANCES))
DRY = ("rear_dry_friction", "front_dry_friction")
ONSET = Quantity(0.1, 0.0, 1.0, 0.5, 0.5)  # `Worm.onset`
EXACT = 1e-7  # prior standard deviation of an exact parameter, relative to its value
LOAD_STEP, MOST_LOAD = 0.05, 50.0  # N, derivative step and largest magnitude of the load
SEARCHED = np.linspace(-12.0, 12.0, 13)  # N, loads from which fits start
FIRST_REACH = 0.1  # N, first step of the search for an end of the interval
MOST_RESTARTS = 10  # number of better fits found by the profile after which the test fails
LOAD = 0  # entry of the load among the shared parameters
NO_FIT = (
    "no load explains the motion of x1 in fits that start from -12 to 12 N; check the parameter file and the starts of "
    "the runs"
)
NOT_SETTLED = (
    "the load has no valid interval: each fit found a better load far from the previous one; check the parameter "
    "file, the pitch first, and add a run"
)


@dataclass(frozen=True)
class PullTest:
    """Result of a pull test.

    Attributes:
        load: estimated load on the rear module, N, positive towards −x.
        runs: the runs that were used.
        residuals: root mean square of the residuals of x1 in each run, m.
        warnings: remarks on the data.
    """

    load: Estimate
    runs: tuple[Run, ...]
    residuals: tuple[float, ...]
    warnings: tuple[str, ...]


def estimate_rear_load(inputs: Inputs, reference: ReferenceValues) -> PullTest:
    """Estimate the load on the rear module of a known robot, positive towards −x.

    The front load of ``reference`` is subtracted from the estimated sum of both loads. Raises `IdentificationError` if
    no run is usable, if no load explains the runs, if the strides contradict the pitch, or if the profile repeatedly
    finds a better fit.
    """
    parameters = reference.parameters
    runs, warnings = fitted_runs(inputs.recordings, parameters.pitch)
    deviation = reference.estimate("pitch").spread / NORMAL
    check_pitch([run.recording for run in runs], parameters.pitch, deviation)
    traverses = [run.traverse for run in runs]
    build = partial(_problem, traverses, reference)
    fit = fit_uneven(build, _start(traverses, build, parameters))
    for _ in range(MOST_RESTARTS):
        interval, better = _profile(traverses, build, fit)
        if better is None:
            break
        fit = replace(fit, solution=better)
    else:
        raise IdentificationError(NOT_SETTLED)
    value = float(fit.solution.shared[LOAD])
    exact = [key for key in NUISANCES if key not in (*DRY, *reference.intervals)]
    note = f"the interval assumes exact values of {', '.join(exact)}" if exact else ""
    residuals = tuple(
        float(np.sqrt(np.mean(r**2))) * t.noise
        for r, t in zip(fit.solution.residuals, traverses, strict=True)
    )
    value, low, high = (total - parameters.front_load for total in (value, *interval))
    return PullTest(
        Estimate(value, low, high, note=note), tuple(runs), residuals, (*inputs.remarks, *warnings)
    )


def _quantity(reference: ReferenceValues, key: str) -> Quantity:
    """Return a parameter of the robot with its interval as the prior.

    Without an interval, the prior of dry friction is `USUAL_DRY`, and any other parameter counts as exact.
    """
    estimate, row = reference.estimate(key), ROWS[key]
    spread = estimate.spread / NORMAL
    if not np.isfinite(spread):
        spread = USUAL_DRY if key in DRY else 0.0
    spread = max(spread, EXACT * max(abs(estimate.value), row["low"], EXACT))
    return Quantity(NUISANCES[key], row["low"], row["high"], estimate.value, spread)


def _problem(
    traverses: Sequence[locomotion.Traverse],
    reference: ReferenceValues,
    places: NDArray[np.int64],
    scatter: Scatter,
) -> Problem:
    """Return the least-squares problem of x1.

    All runs share the load, the onset, the robot's parameters and the deviations of the grooves. Each run has its own
    L0 and pose at rest.
    """
    parameters = reference.parameters
    unloaded = parameters.replace(rear_load=0.0, front_load=0.0)
    worm = locomotion.worm_of(unloaded)
    shared = [
        Quantity(LOAD_STEP, -MOST_LOAD, MOST_LOAD),
        ONSET,
        *(_quantity(reference, key) for key in NUISANCES),
        *deviation_quantities(places, scatter, parameters.pitch),
    ]
    first = len(shared) - len(places)

    def residuals(run: int, values: Array, own: Array) -> Array:
        robot = _loaded(worm, values[:first], own)
        return locomotion.x1_residuals(traverses[run], robot, *tables_of(values[first:], places))

    own = [locomotion.own_quantities(t, parameters, parameters.clearance) for t in traverses]
    return Problem(residuals, shared, own, jumps=True)


def _loaded(worm: locomotion.Worm, values: Array, own: Array) -> locomotion.Worm:
    """Return the robot with given shared ``values`` and the nuisance parameters ``own`` of a run.

    The sum of both loads acts on the rear module.
    """
    load, onset, *others = values
    return worm.begun(_PLACES, np.array([load, *others]), own, onset)


def _start(
    traverses: Sequence[locomotion.Traverse], build: partial[Problem], parameters: Parameters
) -> Solution:
    """Return the best of the fits with even grooves that start from the loads `SEARCHED`."""
    problem = build(np.empty((0, 3), np.int64), Scatter(0.0, 0.0))
    centres = np.array([quantity.centre for quantity in problem.shared])

    def fit(load: float) -> Solution:
        shared = centres.copy()
        shared[LOAD] = load
        sag = np.sign(load) * 0.5 * parameters.clearance + load / parameters.engaged_stiffness
        own = np.array([[t.length.initial_length, -sag] for t in traverses])
        return solve(problem, shared, own, iterations=12)

    best = min(map(fit, SEARCHED.tolist()), key=lambda solution: solution.cost)
    if max(float(np.sqrt(np.mean(r**2))) for r in best.residuals) >= locomotion.LOST:
        raise IdentificationError(NO_FIT)
    return best


def _profile(
    traverses: Sequence[locomotion.Traverse], build: partial[Problem], fit: GrooveFit
) -> tuple[tuple[float, float], Solution | None]:
    """Return the interval (low, high) of the sum of both loads in N, and None.

    If the profile finds a solution with a lower cost, the result contains this solution instead of None. The interval
    is then invalid.
    """
    problem = build(fit.places, fit.scatter)
    rise = NORMAL**2 * variance_inflation(traverses, fit.solution)
    value = float(fit.solution.shared[LOAD])
    met: list[Solution] = []

    def cost(at: float) -> float:
        solution = fixed_at(problem, fit.solution, LOAD, at)
        if solution.cost < fit.solution.cost - BETTER:
            met.append(solution)
            return rise
        return max(solution.cost - fit.solution.cost, 0.0)

    low, high = (
        follow_profile(cost, value, rise, sign * FIRST_REACH, MOST_LOAD) for sign in (-1.0, 1.0)
    )
    if met:
        best = min(met, key=lambda solution: solution.cost)
        return (low, high), solve(problem, best.shared, best.own)
    return (low, high), None


def loaded_file(result: PullTest, robot: ParameterFile) -> ParameterFile:
    """Return the parameter file of a known robot with the estimated load and its interval."""
    load = result.load
    runs = {
        run.name: {"date": run.recording.date or "not recorded", **run.recording.sources}
        for run in result.runs
    }
    provenance = {**robot.provenance, "pull_test": {"code": code_version(), "runs": runs}}
    return replace(
        robot,
        parameters=robot.parameters.replace(**{KEY: load.value}),
        intervals={**robot.intervals, KEY: (load.low, load.high)},
        provenance=provenance,
    )
