# SPDX-License-Identifier: Apache-2.0
"""Stage 4: friction η and switching threshold p_sw from x1 under the measured length (eq:locomotion_identification_cost).

J_loc jumps where a groove is gained or lost, so a grid over all that is admissible comes first, and the deepest of its
valleys are refined. Nuisances: dry friction of each module, which would be booked as η, and L0 of each run, of
which the camera has seen something at rest.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from worm_model.identification.blocks import Problem, Quantity, Solution, solve
from worm_model.identification.errors import IdentificationError
from worm_model.identification.measured_length import MeasuredLength
from worm_model.identification.recording import Recording
from worm_model.identification.robust import noise_of
from worm_model.kernel import dry_friction
from worm_model.parameters import Parameters

Array = NDArray[np.float64]

RIDGES = 5  # of a traversal
LEAST_NOISE = 2e-5  # m, of a position: that of a perfect camera
SEARCHED_FRICTION = np.geomspace(4.0, 1500.0, 14)  # N·s/m
SEARCHED_THRESHOLD_STEP = 2e-4  # m
MOST_THRESHOLD = 1.7  # pitches
VALLEYS = 6  # that are refined
LOST = 1e3  # residual of a sample that no motion explains: the anchors switch without end
SHARED = ("viscous_friction", "switching_threshold", "rear_dry_friction", "front_dry_friction")


@dataclass(frozen=True)
class Traverse:
    """A run over the five ridges: camera samples ``time`` (n,) s, ``x1`` (n,) m, and the length that drives it.

    ``noise`` m is the camera's; ``complete`` tells whether five ridges were reached, ``end`` s when.
    """

    name: str
    direction: int
    time: Array
    x1: Array
    length: MeasuredLength
    noise: float
    end: float
    complete: bool


@dataclass(frozen=True)
class LocomotionFit:
    """η in N·s/m and p_sw in m; dry friction of both modules in N; ``initial_length`` (runs,) in m; ``residuals``
    of each run in m.
    """

    viscous_friction: float
    switching_threshold: float
    rear_dry_friction: float
    front_dry_friction: float
    initial_length: Array
    residuals: tuple[Array, ...]
    solution: Solution

    @property
    def values(self) -> Array:
        """(η, p_sw, rear and front dry friction)."""
        return self.solution.shared


def traverse_of(recording: Recording, length: MeasuredLength, pitch: float) -> Traverse:
    """The part of a run from the onset until x1 has advanced by five pitches."""
    advance = recording.gait.direction * recording.x1
    smooth = np.array([np.nanmedian(advance[max(k - 2, 0) : k + 3]) for k in range(advance.size)])
    beyond = np.flatnonzero((smooth >= RIDGES * pitch) & (recording.camera_time > 0.0))
    end = float(recording.camera_time[beyond[0]]) if beyond.size else recording.end
    end = min(end, float(length.time[-1]))
    kept = (recording.camera_time >= length.time[0]) & (recording.camera_time <= end)
    kept &= np.isfinite(recording.x1)
    return Traverse(
        recording.name,
        recording.gait.direction,
        recording.camera_time[kept],
        recording.x1[kept],
        length,
        max(noise_of(recording.x1), LEAST_NOISE),
        end,
        bool(beyond.size),
    )


SAME=np.zeros((1,2))
def slide(
    traverse: Traverse, parameters: Parameters, dry: tuple[float, float], stride: int = 1,rg=SAME,fg=SAME) -> Array | None:
    """Samples of `worm_model.kernel.dry_friction` at every ``stride``-th time of the length; None on chatter."""
    length_changes = np.ascontiguousarray(traverse.length.length_change[::stride])
    samples = np.empty((length_changes.size, dry_friction.SAMPLE_COLUMNS))
    worm = dry_friction.Worm(
        float(traverse.direction),
        parameters.rear_mass,
        parameters.front_mass,
        parameters.initial_length,
        parameters.viscous_friction,
        parameters.pitch,
        parameters.engaged_stiffness,
        parameters.disengaged_stiffness,
        parameters.switching_threshold,
        parameters.clearance,
        *dry,
    )
    switches = dry_friction.slide(traverse.length.step * stride, length_changes, worm, rg,fg,samples)
    return None if switches < 0 else samples


def locomotion_problem(traverses: Sequence[Traverse], parameters: Parameters, stride: int = 1) -> Problem:
    """Residuals of x1 in units of the camera's noise; the other parameters are given."""
    low = least_threshold(parameters)
    shared = (
        Quantity(1.0, 1.0, 1e4),
        Quantity(3e-5, low, MOST_THRESHOLD * parameters.pitch),
        Quantity(0.02, 0.0, 5.0),
        Quantity(0.02, 0.0, 5.0),
    )

    def residuals(run: int, values: Array, own: Array) -> Array:
        traverse = traverses[run]
        tried = parameters.replace(
            viscous_friction=values[0], switching_threshold=values[1], initial_length=own[0]
        )
        samples = slide(traverse, tried, (values[2], values[3]), stride)
        if samples is None:
            return np.full(traverse.time.size, LOST)
        predicted = np.interp(
            traverse.time, traverse.length.time[::stride], samples[:, dry_friction.X1]
        )
        return (traverse.x1 - predicted) / traverse.noise

    own = [
        (Quantity(5e-5, 0.0, np.inf, t.length.initial_length, t.length.initial_spread),)
        for t in traverses
    ]
    return Problem(residuals, shared, own)


def least_threshold(parameters: Parameters) -> float:
    """Below it a fin that switches would switch back at once, or never touch; m."""
    return 0.5 * max(parameters.pitch, parameters.clearance) + 1e-4


@dataclass(frozen=True)
class Landscape:
    """J_loc over ``friction`` (m,) N·s/m and ``threshold`` (n,) m: ``cost`` (m, n), mean square of x1's error in m²."""

    friction: Array
    threshold: Array
    cost: Array


def search(
    traverses: Sequence[Traverse],
    parameters: Parameters,
    progress: Callable[[float], None] | None = None,
) -> Landscape:
    """J_loc without dry friction over every admissible pair, L0 of each run as the camera saw it at rest."""
    stride = 2  # a grid needs half the resolution
    problem = locomotion_problem(traverses, parameters, stride)
    own = np.array([[t.length.initial_length] for t in traverses])
    threshold = np.arange(
        least_threshold(parameters), MOST_THRESHOLD * parameters.pitch, SEARCHED_THRESHOLD_STEP
    )
    cost = np.empty((SEARCHED_FRICTION.size, threshold.size))
    samples = sum(t.time.size for t in traverses)

    def fill(row: int) -> None:
        for column, value in enumerate(threshold):
            values = np.array([SEARCHED_FRICTION[row], value, 0.0, 0.0])
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
    """(k, 2): the deepest local minima of a landscape, (η, p_sw), deepest first."""
    padded = np.pad(landscape.cost, 1, constant_values=np.inf)
    rows, columns = landscape.cost.shape
    around = [
        padded[1 + i : 1 + i + rows, 1 + j : 1 + j + columns]
        for i in (-1, 0, 1)
        for j in (-1, 0, 1)
        if (i, j) != (0, 0)
    ]
    lowest = landscape.cost <= np.min(around, axis=0)
    found = np.argwhere(lowest)
    order = np.argsort(landscape.cost[lowest])[:count]
    return np.array(
        [(landscape.friction[i], landscape.threshold[j]) for i, j in found[order]]
    )


def fit_locomotion(
    traverses: Sequence[Traverse], parameters: Parameters, landscape: Landscape | None = None
) -> LocomotionFit:
    """η and p_sw, the best of the refined valleys; the other values of ``parameters`` are given.

    Raises `IdentificationError` if nothing explains the motion.
    """
    surface = search(traverses, parameters) if landscape is None else landscape
    problem = locomotion_problem(traverses, parameters)
    own = np.array([[t.length.initial_length] for t in traverses])
    solutions = [
        solve(problem, np.array([*start, 0.05, 0.05]), own) for start in valleys(surface)
    ]
    best = min(solutions, key=lambda solution: solution.cost)
    worst = max(float(np.sqrt(np.mean(r**2))) for r in best.residuals)
    if worst >= LOST:
        raise IdentificationError("no friction and threshold explain the motion of x1: is it a worm's?")
    return locomotion_fit(traverses, best)


def locomotion_fit(traverses: Sequence[Traverse], solution: Solution) -> LocomotionFit:
    """Names the entries of a solution of `locomotion_problem`."""
    return LocomotionFit(
        *map(float, solution.shared),
        initial_length=solution.own[:, 0],
        residuals=tuple(r * t.noise for r, t in zip(solution.residuals, traverses, strict=True)),
        solution=solution,
    )
