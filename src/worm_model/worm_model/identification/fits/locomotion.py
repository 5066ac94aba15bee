# SPDX-License-Identifier: Apache-2.0
"""Stage 4: friction η and threshold p_sw from x1 under the measured length (eq:locomotion_identification_cost).

J_loc jumps where a groove is gained or lost. The search therefore starts with a grid over all admissible values, and
refines the deepest valleys. The nuisance parameters are:

- the dry friction of each module, which would otherwise count as η
- L0 of each run, which the camera measures at rest
- the pitch: the front fin starts L0/d ≈ 17 grooves ahead of the rear one, so that an error of 0.05 mm in d moves its
  start by almost 1 mm
- the onset: the length starts with a finite rate (eq:slack_clip). With the paper's v1(0) = 0 the centre of mass is
  0.1 mm away from that of a robot, whose modules share that rate

The stepped kernel computes x1, because it supports uneven grooves and takes 0.09 µs per sample of the length. The exact
kernel takes 0.21 µs, with dry friction 0.27 µs. Predictions and held-out errors use the exact model.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import median_filter

from worm_model.arrays import Array
from worm_model.identification.data.measured_length import MeasuredLength
from worm_model.identification.data.observed_run import Recording
from worm_model.identification.fits.block_least_squares import Problem, Quantity, Solution, solve
from worm_model.identification.fits.robust import noise_of
from worm_model.identification.identification_errors import IdentificationError
from worm_model.parameters import ParameterError, Parameters
from worm_model.simulation.kernel import stepped_dry_friction as dry_friction
from worm_model.simulation.simulator import SETTLING_TIME

RIDGES = 5  # number of ridges of a traverse
LEAST_NOISE = 2e-5  # m, noise of a position from a perfect camera
SEARCHED_FRICTION = np.geomspace(4.0, 1500.0, 14)  # N·s/m
SEARCHED_THRESHOLD_STEP = 2e-4  # m
MOST_THRESHOLD = 1.7  # pitches
VALLEYS = 6  # number of valleys from which fits start
COARSE = 2  # steps of the length combined into one, where half the resolution suffices
ROUGH_ITERATIONS = 10  # iterations of the fit from each start
REFINED = 4  # number of these fits that are completed
FIRST_DRY = (0.05, 0.05)  # N, start of the search for dry friction
FIRST_ONSET = 0.5
LOST = 1e3  # residual of each sample if the anchors switch endlessly
ALIKE = np.zeros((1, dry_friction.GROOVE_COLUMNS))  # even grooves
SHARED = (
    "viscous_friction",
    "switching_threshold",
    "rear_dry_friction",
    "front_dry_friction",
    "pitch",
    "onset",
)
LEAST_PITCH_DEVIATION = 1e-8  # m, for a pitch given as exact
TRIED_PITCHES = (-1.5, 0.0, 1.5)  # starts of a fit, in standard deviations from the given pitch


@dataclass(frozen=True)
class Known:
    """Inputs of stage 4: ``parameters`` that it does not estimate, and the uncertainty of their pitch.

    ``pitch_deviation`` is the standard deviation of the given pitch in m; 0 fixes the pitch.
    """

    parameters: Parameters
    pitch_deviation: float


@dataclass(frozen=True)
class Traverse:
    """Run over the five ridges: camera samples ``time`` (n,) s, ``x1`` (n,) m, and the length that drives it.

    ``noise`` (m) is that of the camera. ``end`` (s) is the end of the traverse; ``complete`` is True if the run reached
    five ridges.
    """

    direction: int
    time: Array
    x1: Array
    length: MeasuredLength
    noise: float
    end: float
    complete: bool


def traverse_of(recording: Recording, length: MeasuredLength, pitch: float) -> Traverse:
    """Return the part of a run from the onset until x1 has advanced by five pitches."""
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


def worm_of(parameters: Parameters, direction: int) -> dry_friction.Worm:
    """Return the parameters in the kernel's form, without dry friction; raise `ParameterError` under a load."""
    for key in ("rear_load", "front_load"):
        if getattr(parameters, key) != 0.0:
            raise ParameterError(f"{key}: the fit of the motion does not include loads; use 0 N")
    return dry_friction.Worm(
        direction=float(direction),
        rear_mass=parameters.rear_mass,
        front_mass=parameters.front_mass,
        initial_length=parameters.initial_length,
        friction=parameters.viscous_friction,
        pitch=parameters.pitch,
        engaged_stiffness=parameters.engaged_stiffness,
        disengaged_stiffness=parameters.disengaged_stiffness,
        threshold=parameters.switching_threshold,
        clearance=parameters.clearance,
        rear_dry=0.0,
        front_dry=0.0,
    )


def with_values(worm: dry_friction.Worm, values: Array, initial_length: float) -> dry_friction.Worm:
    """Return the worm with other (η, p_sw, both dry frictions, pitch, onset) and L0.

    It has no loop over names, because a fit calls it 10⁵ times.
    """
    return worm._replace(
        friction=float(values[0]),
        threshold=float(values[1]),
        rear_dry=float(values[2]),
        front_dry=float(values[3]),
        pitch=float(values[4]),
        onset=float(values[5]),
        initial_length=float(initial_length),
    )


def slide(
    traverse: Traverse,
    worm: dry_friction.Worm,
    rear_grooves: Array = ALIKE,
    front_grooves: Array = ALIKE,
    stride: int = 1,
) -> Array | None:
    """Return samples of the stepped kernel at every ``stride``-th time of the length; None on chatter.

    A run under pretension begins with straight fins, before the cable is tensioned. x1 counts from the rest after that.
    """
    step = traverse.length.step * stride
    length_changes = traverse.length.length_change
    tensioning = _tensioning(length_changes[0], step)
    if stride > 1 or tensioning.size:
        length_changes = np.concatenate([tensioning, length_changes[::stride]])
    samples = np.empty((length_changes.size, dry_friction.SAMPLE_COLUMNS))
    switches = dry_friction.slide(step, length_changes, worm, rear_grooves, front_grooves, samples)
    if switches < 0:
        return None
    samples = samples[tensioning.size :]
    samples[:, dry_friction.X1] -= samples[0, dry_friction.X1]
    return samples


def _tensioning(length_change: float, step: float) -> Array:
    """Return the ΔL (m) at every ``step`` (s) of a body that is shortened to its rest under pretension and settles.

    It has no samples if that rest is ΔL = 0.
    """
    if length_change == 0.0:
        return np.empty(0)
    share = np.arange(round(2.0 * SETTLING_TIME / step)) * step / SETTLING_TIME
    return length_change * np.minimum(share, 1.0)


def shared_quantities(known: Known) -> list[Quantity]:
    """Return the quantities η, p_sw, rear and front dry friction, pitch and onset."""
    pitch = known.parameters.pitch
    deviation = max(known.pitch_deviation, LEAST_PITCH_DEVIATION)
    low = least_threshold(known.parameters)
    return [
        Quantity(1.0, 1.0, 1e4),
        Quantity(3e-5, low, MOST_THRESHOLD * pitch),
        Quantity(0.02, 0.0, 5.0),
        Quantity(0.02, 0.0, 5.0),
        Quantity(2e-6, 0.5 * pitch, 1.5 * pitch, pitch, deviation),
        Quantity(0.1, 0.0, 1.0, 0.5, 0.5),
    ]


def own_quantities(traverse: Traverse) -> list[Quantity]:
    """Return the nuisance parameter L0 of a run; its prior is the length that the camera measured at rest."""
    length = traverse.length
    return [Quantity(5e-5, 0.0, np.inf, length.initial_length, length.initial_spread)]


def x1_residuals(traverse: Traverse, samples: Array | None, stride: int = 1) -> Array:
    """Return measured minus predicted x1 in units of the camera's noise."""
    if samples is None:
        return np.full(traverse.time.size, LOST)
    time = traverse.length.time[::stride]
    predicted = np.interp(traverse.time, time, samples[:, dry_friction.X1])
    return (traverse.x1 - predicted) / traverse.noise


def locomotion_problem(traverses: Sequence[Traverse], known: Known, stride: int = 1) -> Problem:
    """Return the problem with even grooves; all other parameters are given."""
    worms = [worm_of(known.parameters, t.direction) for t in traverses]

    def residuals(run: int, values: Array, own: Array) -> Array:
        worm = with_values(worms[run], values, own[0])
        return x1_residuals(traverses[run], slide(traverses[run], worm, stride=stride), stride)

    own = [own_quantities(t) for t in traverses]
    return Problem(residuals, shared_quantities(known), own, jumps=True)


def least_threshold(parameters: Parameters) -> float:
    """Return the threshold (m) below which a fin would switch back at once, or never touch."""
    return 0.5 * max(parameters.pitch, parameters.clearance) + 1e-4


@dataclass(frozen=True)
class Landscape:
    """J_loc over ``friction`` (m,) in N·s/m and ``threshold`` (n,) in m: ``cost`` (m, n), mean squared error in m²."""

    friction: Array
    threshold: Array
    cost: Array


def search(
    traverses: Sequence[Traverse],
    known: Known,
    progress: Callable[[float], None] | None = None,
) -> Landscape:
    """Return J_loc without dry friction over all admissible pairs, with the given pitch and the measured L0."""
    parameters = known.parameters
    problem = locomotion_problem(traverses, known, COARSE)
    own = np.array([[t.length.initial_length] for t in traverses])
    threshold = np.arange(
        least_threshold(parameters), MOST_THRESHOLD * parameters.pitch, SEARCHED_THRESHOLD_STEP
    )
    cost = np.empty((SEARCHED_FRICTION.size, threshold.size))
    samples = sum(t.time.size for t in traverses)

    def fill(row: int) -> None:
        for column, value in enumerate(threshold):
            values = np.array(
                [SEARCHED_FRICTION[row], value, 0.0, 0.0, parameters.pitch, FIRST_ONSET]
            )
            squares = [
                float(np.sum((problem.residuals(run, values, own[run]) * t.noise) ** 2))
                for run, t in enumerate(traverses)
            ]
            cost[row, column] = sum(squares) / samples

    with ThreadPoolExecutor() as pool:
        for done, _ in enumerate(pool.map(fill, range(SEARCHED_FRICTION.size)), 1):
            if progress is not None:
                progress(done / SEARCHED_FRICTION.size)
    return Landscape(SEARCHED_FRICTION, threshold, cost)


def valleys(landscape: Landscape, count: int = VALLEYS) -> Array:
    """Return the deepest local minima (η, p_sw) of a landscape, deepest first, shape (k, 2)."""
    padded = np.pad(landscape.cost, 1, constant_values=np.inf)
    rows, columns = landscape.cost.shape
    around = [
        padded[1 + i : 1 + i + rows, 1 + j : 1 + j + columns]
        for i in (-1, 0, 1)
        for j in (-1, 0, 1)
        if (i, j) != (0, 0)
    ]
    lowest = landscape.cost <= np.min(around, axis=0)
    cells = np.argwhere(lowest)
    order = np.argsort(landscape.cost[lowest])[:count]
    return np.array([(landscape.friction[i], landscape.threshold[j]) for i, j in cells[order]])


def find_locomotion(traverses: Sequence[Traverse], known: Known, landscape: Landscape) -> Solution:
    """Return the best of the landscape's valleys, refined with all nuisance parameters and even grooves.

    Raises `IdentificationError` if nothing explains the motion.
    """
    own = np.array([[t.length.initial_length] for t in traverses])
    tried = TRIED_PITCHES if known.pitch_deviation > 0.0 else (0.0,)
    pitches = [known.parameters.pitch + z * known.pitch_deviation for z in tried]
    starts = [
        np.array([*valley, *FIRST_DRY, pitch, FIRST_ONSET])
        for valley in valleys(landscape)
        for pitch in pitches
    ]
    rough = locomotion_problem(traverses, known, COARSE)
    problem = locomotion_problem(traverses, known)
    with ThreadPoolExecutor() as pool:
        near = list(pool.map(lambda s: solve(rough, s, own, iterations=ROUGH_ITERATIONS), starts))
        near.sort(key=lambda solution: solution.cost)
        solutions = list(pool.map(lambda s: solve(problem, s.shared, s.own), near[:REFINED]))
    best = min(solutions, key=lambda solution: solution.cost)
    if max(float(np.sqrt(np.mean(r**2))) for r in best.residuals) >= LOST:
        raise IdentificationError(
            "no friction and threshold explain the motion of x1: is this a worm in a corrugated pipe?"
        )
    return best
