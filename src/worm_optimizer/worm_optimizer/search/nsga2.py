# SPDX-License-Identifier: Apache-2.0
"""NSGA-II, the paper's method, and the comparison of its front with the exact one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from pymoo.algorithms.moo.nsga2 import NSGA2
from pymoo.core.problem import Problem
from pymoo.indicators.hv import HV
from pymoo.optimize import minimize

from worm_optimizer.evaluation.task import Array, Index, Points, Task
from worm_optimizer.search.exact import ExactFront
from worm_optimizer.search.pareto import front_of
from worm_optimizer.search.search_settings import Nsga2Settings


class _GaitProblem(Problem):
    """Decision vector [S, f] in its box, objectives [−v̄, P̄], one constraint (at most 0).

    The constraint excludes gaits that violate a limit or do not move. Gaits that do not move need the least power.
    They would therefore be Pareto-optimal in the problem as the paper states it. ``front`` contains the non-dominated
    gaits of all evaluated ones.
    """

    def __init__(self, task: Task) -> None:
        box = task.bounds
        low, high = (
            np.array([box.stroke_low, box.frequency_low]),
            np.array([box.stroke_high, box.frequency_high]),
        )
        super().__init__(n_var=2, n_obj=2, n_ieq_constr=1, xl=low, xu=high)
        self._task = task
        self.front = task.points(np.empty(0), np.empty(0))

    def _evaluate(self, x: Array, out: dict[str, Array], *_: Any, **__: Any) -> None:
        points = self._task.points(*x.T)
        self.front = front_of(Points.join(self.front, points))
        out["F"] = np.column_stack([-points.speed, points.power])
        out["G"] = points.violation[:, np.newaxis]


def nsga2_front(
    task: Task, settings: Nsga2Settings, progress: Callable[[float], None] = lambda _: None
) -> Points:
    """Run NSGA-II on a task, and return the non-dominated gaits of all evaluated ones, by rising speed.

    Equal seeds result in equal fronts. ``progress`` is called with the finished share of the generations.
    """
    problem, generations = _GaitProblem(task), settings.generations
    minimize(
        problem,
        NSGA2(pop_size=settings.population),
        ("n_gen", generations),
        seed=settings.seed,
        callback=lambda algorithm: progress(algorithm.n_gen / generations),
    )
    return problem.front


# Power at the corner of the hypervolume, relative to the highest power of the exact front. With 1, the fastest gait
# would not contribute.
_CORNER = 1.1


@dataclass(frozen=True)
class Comparison:
    """Comparison of a front of NSGA-II with the exact one.

    Attributes:
        front: front of NSGA-II.
        hypervolume_share: its hypervolume, relative to that of the exact front; see `hypervolume`.
        missed_branches: grooves per cycle of the branches that only the exact front contains.
        largest_excess_power: largest relative excess of the power of a gait of NSGA-II over the lowest power of all
            gaits that are at least as fast.
    """

    front: Points
    hypervolume_share: float
    missed_branches: tuple[float, ...]
    largest_excess_power: float


def compared(exact: ExactFront, front: Points) -> Comparison:
    """Compare a front of the same task, which contains at least one gait, with the exact front.

    Edges are also computed at the frequencies of the compared gaits, because the exact front covers only some
    frequencies.
    """
    frequency = np.unique(front.frequency)
    box, strokes = exact.task.bounds, exact.resolution.strokes
    scan = np.linspace(box.stroke_low, box.stroke_high, strokes)
    edges = exact.task.edges(frequency, np.tile(scan, (frequency.size, 1)))
    best = front_of(Points.join(exact.front, edges.points))
    corner = _CORNER * float(exact.front.power.max())  # W
    missed = sorted(set(exact.front.grooves.tolist()) - set(front.grooves.tolist()))
    return Comparison(
        front=front,
        hypervolume_share=hypervolume(front, corner) / hypervolume(best, corner),
        missed_branches=tuple(missed),
        largest_excess_power=float(np.max(front.power / _lowest_power(best, front) - 1.0)),
    )


def hypervolume(front: Points, reference_power: float) -> float:
    """Return the area in m/s·W that a front dominates up to the corner (0 m/s, ``reference_power`` W)."""
    return float(
        HV(ref_point=[0.0, reference_power])(np.stack([-front.speed, front.power], axis=1))
    )


def _lowest_power(best: Points, front: Points) -> Array:
    """Return the lowest power (W) among the gaits of ``best`` that are at least as fast as each gait of ``front``.

    Speeds are compared by grooves per second. ``best`` is a result of `front_of`.
    """
    reached, wanted = (points.count * points.frequency for points in (best, front))
    place: Index = np.searchsorted(reached, wanted * (1.0 - 1e-9))
    return best.power[np.minimum(place, len(best) - 1)]
