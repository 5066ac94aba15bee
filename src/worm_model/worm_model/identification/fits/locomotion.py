# SPDX-License-Identifier: Apache-2.0
"""Stage 4: friction η and threshold p_sw from x1 under the measured length (eq:locomotion_identification_cost).

J_loc jumps where a groove is gained or lost. The search therefore starts with a grid over all admissible values, and
refines the deepest valleys. The nuisance parameters are:

- the dry friction of each module, which would otherwise count as η
- L0 of each run, which the camera measures at rest
- the pose at rest of each run with pretension: dry friction can hold the modules at a distance of at most
  (D1 + D2)/(k_eng + k_dis) from the pose in which the bent fins balance each other
- the pitch: the front fin starts L0/d ≈ 17 grooves ahead of the rear one, so that an error of 0.05 mm in d moves the
  start of the front fin by almost 1 mm
- the parameter ``onset``: at the onset the rate of ΔL jumps to a finite value (eq:slack_clip). 0: the centre of mass
  stays at rest. 1: the rear module does, v1(0) = 0 as in the paper. The difference shifts the centre of mass by 0.1 mm

The kernel computes x1 without time steps. The length is given by cubics between every fourth sample (`KNOTS`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter, minimum_filter

from worm_model.arrays import Array
from worm_model.identification.data.observed_run import Recording
from worm_model.identification.fits.block_least_squares import Problem, Quantity, Solution, solve
from worm_model.identification.fits.estimate import noise_of
from worm_model.identification.fits.measured_length import MeasuredLength
from worm_model.parameters import ParameterError, Parameters
from worm_model.simulation.kernel import march
from worm_model.simulation.kernel.grooves import EVEN
from worm_model.simulation.kernel.whole_run import run_from_rest
from worm_model.simulation.rows import PARAMETER_ROW, parameter_rows
from worm_model.simulation.smoothing import Smoothed

RIDGES = 5  # number of ridges of a traverse; a module passes a ridge when it advances by a pitch
LEAST_NOISE = 2e-5  # m, lower bound of the noise of a position
# Grid of the search
SEARCHED_FRICTION = np.geomspace(4.0, 1500.0, 14)  # N·s/m, values of η
SEARCHED_THRESHOLD_STEP = 2e-4  # m, step of p_sw
MOST_THRESHOLD = 1.7  # largest p_sw, in pitches
VALLEYS = 6  # number of local minima on the grid from which fits start
ROUGH_ITERATIONS = 10  # iterations of the fit from each start
REFINED = 4  # number of these fits that are completed
FIRST_DRY = (0.05, 0.05)  # N, dry friction of both modules from which fits start
FIRST_ONSET = 0.5  # onset from which fits start
LOST = 1e3  # residual of each sample if the anchors switch endlessly
KNOTS = 4  # distance of the knots of the cubics, in samples of the length: 32 ms
#: names of the shared parameters of all runs
SHARED = (
    "viscous_friction",
    "switching_threshold",
    "rear_dry_friction",
    "front_dry_friction",
    "pitch",
    "onset",
)
LEAST_DEVIATION = 1e-8  # m, prior standard deviation of a pitch or a pose that is fixed
TRIED_PITCHES = (-1.5, 0.0, 1.5)  # starts of a fit, in standard deviations from the given pitch


@dataclass(frozen=True)
class Known:
    """Inputs of stage 4: given ``parameters``, and the uncertainty of the given pitch.

    ``pitch_deviation`` is the standard deviation of the given pitch in m; 0 fixes the pitch.
    """

    parameters: Parameters
    pitch_deviation: float


@dataclass(frozen=True)
class Traverse:
    """Part of a run until x1 has advanced by five pitches, so that the rear module has passed five ridges.

    Attributes:
        direction: direction of the gait, ±1.
        time, x1: camera samples with a visible rear marker, s and m, shape (n,).
        length: measured length, which drives the motion.
        noise: the camera's noise, m.
        end: end of the traverse on the camera's clock, s. If the run passes fewer ridges, it is the end of the run.
        complete: True if the run passed five ridges.
    """

    direction: int
    time: Array
    x1: Array
    length: MeasuredLength
    noise: float
    end: float
    complete: bool

    @cached_property
    def sampled(self) -> Array:
        """Last time at rest, followed by the times at which x1 is compared, s, shape (n + 1,)."""
        return np.append(self.length.time[0], self.time)

    @property
    def tensioned(self) -> bool:
        """True if a pretension has bent the fins before the run."""
        return bool(self.length.length_change[0] != 0.0)

    @cached_property
    def form(self) -> tuple[Array, Array]:
        """Breaks (m,) in s and coefficients (4, m − 1) of ΔL as cubics, constant term first."""
        length = self.length
        knots = np.append(np.arange(0, length.time.size - 1, KNOTS), length.time.size - 1)
        cubics = Smoothed(length.time[knots], length.length_change[knots], length.rate[knots])
        return cubics.cubic()


def traverse_of(recording: Recording, length: MeasuredLength, pitch: float) -> Traverse:
    """Return the traverse of a run."""
    advance = recording.gait.direction * recording.x1
    known = np.isfinite(advance)
    beyond = median_filter(advance[known], 5) >= RIDGES * pitch  # a single outlier does not count
    arrivals = recording.camera_time[known][beyond]
    end = float(arrivals[0]) if arrivals.size else recording.end
    end = min(end, float(length.time[-1]))
    kept = (recording.camera_time >= length.time[0]) & (recording.camera_time <= end)
    kept &= np.isfinite(recording.x1)
    return Traverse(
        recording.gait.direction,
        recording.camera_time[kept],
        recording.x1[kept],
        length,
        max(noise_of(recording.x1), LEAST_NOISE),
        end,
        bool(arrivals.size),
    )


def _places_of(keys: Sequence[str]) -> NDArray[np.intp]:
    """Return the places of parameters in the values of a `Worm`, shape (n,)."""
    names = PARAMETER_ROW.names or ()
    return np.array([names.index(key) for key in keys])


_MEANS = _places_of(SHARED[:-1])
(_INITIAL_LENGTH,) = _places_of(["initial_length"])
_ABSENT = _places_of(
    ["rear_dry_friction", "front_dry_friction", "bellows_stiffness", "bellows_damping"]
)


class Worm(NamedTuple):
    """Robot before a run: the values of its parameters in the order of PARAMETER_ROW, and how the run begins.

    For ``deflection`` in m and ``onset`` see `worm_model.simulation.kernel.whole_run.run_from_rest`.
    """

    values: Array
    deflection: float = 0.0
    onset: float = 0.0


def worm_of(parameters: Parameters) -> Worm:
    """Return the robot without dry friction, and without the bellows, which do not affect x1 for a given length.

    Raises `ParameterError` if a load is not zero.
    """
    for key in ("rear_load", "front_load"):
        if getattr(parameters, key) != 0.0:
            raise ParameterError(f"{key}: the fit of the motion does not include loads; use 0 N")
    values = parameter_rows(parameters).view(float)
    values[_ABSENT] = 0.0
    return Worm(values)


def with_means(worm: Worm, means: Array, own: Array) -> Worm:
    """Return the robot with the shared and the nuisance parameters of a run.

    ``means`` are (η, p_sw, both dry frictions, pitch, onset). ``own`` are L0 and the pose at rest, m.
    """
    values = worm.values.copy()
    values[_MEANS] = means[:-1]
    values[_INITIAL_LENGTH] = own[0]
    return Worm(values, float(own[1]), float(means[-1]))


def follow(
    traverse: Traverse,
    worm: Worm,
    times: Array,
    rear_grooves: Array = EVEN,
    front_grooves: Array = EVEN,
) -> Array | None:
    """Return the kernel's samples (n, SAMPLE_COLUMNS) at ascending ``times`` (n,) in s.

    The result is None if the anchors switch endlessly.
    """
    breaks, coefficients = traverse.form
    samples = np.empty((times.size, march.SAMPLE_COLUMNS))
    samples[:, march.TIME] = times
    completed = run_from_rest(
        breaks[: breaks.searchsorted(times[-1]) + 1],
        coefficients,
        worm.values.view(PARAMETER_ROW)[0],
        float(traverse.direction),
        worm.deflection,
        worm.onset,
        rear_grooves,
        front_grooves,
        samples,
    )
    return samples if completed else None


def shared_quantities(known: Known) -> list[Quantity]:
    """Return the quantities η, p_sw, rear and front dry friction, pitch and onset."""
    pitch = known.parameters.pitch
    deviation = max(known.pitch_deviation, LEAST_DEVIATION)
    low = least_threshold(known.parameters)
    return [
        Quantity(1.0, 1.0, 1e4),
        Quantity(3e-5, low, MOST_THRESHOLD * pitch),
        Quantity(0.02, 0.0, 5.0),
        Quantity(0.02, 0.0, 5.0),
        Quantity(2e-6, 0.5 * pitch, 1.5 * pitch, pitch, deviation),
        Quantity(0.1, 0.0, 1.0, 0.5, 0.5),
    ]


def own_quantities(traverses: Sequence[Traverse], known: Known) -> list[list[Quantity]]:
    """Return the nuisance parameters of each run: L0 and the pose at rest.

    The prior of L0 is the measured value. The pose (m) is `Worm.deflection`, which is 0 unless a pretension has bent
    the fins at rest.
    """
    pitch = known.parameters.pitch

    def quantities(traverse: Traverse) -> list[Quantity]:
        length = traverse.length
        pose = known.parameters.clearance if traverse.tensioned else LEAST_DEVIATION
        return [
            Quantity(5e-5, 0.0, np.inf, length.initial_length, length.initial_spread),
            Quantity(5e-5, -pitch, pitch, 0.0, pose),
        ]

    return list(map(quantities, traverses))


def first_own(traverses: Sequence[Traverse]) -> Array:
    """Return the values of the runs' nuisance parameters from which fits start, shape (runs, 2)."""
    return np.array([[t.length.initial_length, 0.0] for t in traverses])


def x1_residuals(
    traverse: Traverse, worm: Worm, rear_grooves: Array = EVEN, front_grooves: Array = EVEN
) -> Array:
    """Return measured minus predicted x1, both relative to the position at rest, in units of the camera's noise."""
    samples = follow(traverse, worm, traverse.sampled, rear_grooves, front_grooves)
    if samples is None:
        return np.full(traverse.time.size, LOST)
    predicted = samples[1:, march.X1] - samples[0, march.X1]
    return (traverse.x1 - predicted) / traverse.noise


def locomotion_problem(traverses: Sequence[Traverse], known: Known) -> Problem:
    """Return the problem of x1 with even grooves.

    The parameters that are neither in `shared_quantities` nor in `own_quantities` have the values of ``known``.
    """
    worm = worm_of(known.parameters)

    def residuals(run: int, values: Array, own: Array) -> Array:
        return x1_residuals(traverses[run], with_means(worm, values, own))

    own = own_quantities(traverses, known)
    return Problem(residuals, shared_quantities(known), own, jumps=True)


def least_threshold(parameters: Parameters) -> float:
    """Return the smallest threshold (m) of a fit.

    With a smaller threshold, a fin would switch back at once, or switch without having touched the wall.
    """
    return 0.5 * max(parameters.pitch, parameters.clearance) + 1e-4


def search(
    traverses: Sequence[Traverse],
    known: Known,
    progress: Callable[[float], None] = lambda _: None,
) -> Array:
    """Return the deepest local minima (η, p_sw) of J_loc on a grid, deepest first, shape (k, 2).

    J_loc is the mean squared error of x1 without dry friction, with the given pitch and the measured L0.
    """
    parameters = known.parameters
    problem = locomotion_problem(traverses, known)
    own = first_own(traverses)
    threshold = np.arange(
        least_threshold(parameters), MOST_THRESHOLD * parameters.pitch, SEARCHED_THRESHOLD_STEP
    )
    cost = np.empty((SEARCHED_FRICTION.size, threshold.size))
    samples = sum(t.time.size for t in traverses)
    for row, friction in enumerate(SEARCHED_FRICTION):
        for column, value in enumerate(threshold):
            values = np.array([friction, value, 0.0, 0.0, parameters.pitch, FIRST_ONSET])
            squares = [
                float(np.sum((problem.residuals(run, values, own[run]) * t.noise) ** 2))
                for run, t in enumerate(traverses)
            ]
            cost[row, column] = sum(squares) / samples
        progress((row + 1) / SEARCHED_FRICTION.size)
    lowest = cost == minimum_filter(cost, 3, mode="constant", cval=np.inf)
    cells = np.argwhere(lowest)[np.argsort(cost[lowest])[:VALLEYS]]
    return np.array([(SEARCHED_FRICTION[i], threshold[j]) for i, j in cells])


def find_locomotion(traverses: Sequence[Traverse], known: Known, valleys: Array) -> Solution:
    """Return the best fit with even grooves and all nuisance parameters, of the fits that start in the ``valleys``."""
    own = first_own(traverses)
    tried = TRIED_PITCHES if known.pitch_deviation > 0.0 else (0.0,)
    pitches = [known.parameters.pitch + z * known.pitch_deviation for z in tried]
    starts = [
        np.array([*valley, *FIRST_DRY, pitch, FIRST_ONSET])
        for valley in valleys
        for pitch in pitches
    ]
    problem = locomotion_problem(traverses, known)
    near = [solve(problem, start, own, iterations=ROUGH_ITERATIONS) for start in starts]
    near.sort(key=lambda solution: solution.cost)
    solutions = (solve(problem, rough.shared, rough.own) for rough in near[:REFINED])
    return min(solutions, key=lambda solution: solution.cost)


def is_lost(solution: Solution) -> bool:
    """Return True if the anchors switch endlessly in a run of a solution, or if x1 is far from it."""
    return max(float(np.sqrt(np.mean(r**2))) for r in solution.residuals) >= LOST
