# SPDX-License-Identifier: Apache-2.0
"""NSGA-II, the paper's method, and the comparison of its front with the exact one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from pymoo.algorithms.moo.nsga2 import NSGA2
from pymoo.core.evaluator import Evaluator
from pymoo.core.population import Population
from pymoo.core.problem import Problem
from pymoo.indicators.hv import HV
from pymoo.problems.static import StaticProblem

from worm_optimizer.evaluation.task import Array, Bounds, Index, Points, Task
from worm_optimizer.search.exact import ExactFront
from worm_optimizer.search.pareto import front_of
from worm_optimizer.search.search_settings import Nsga2Settings


def nsga2_front(
    task: Task, settings: Nsga2Settings, progress: Callable[[float], None] = lambda _: None
) -> Points:
    """Run NSGA-II on a task, and return the non-dominated gaits of all evaluated ones, by rising speed.

    Equal seeds result in equal fronts. ``progress`` is called with the finished share of the generations.
    """
    problem = _gait_problem(task.bounds)
    algorithm = NSGA2(pop_size=settings.population)
    termination = ("n_gen", settings.generations)
    algorithm.setup(problem, termination=termination, seed=settings.seed, verbose=False)
    front = task.points(np.empty(0), np.empty(0))
    while algorithm.has_next():
        population = algorithm.ask()
        if population is None:  # All gaits of the box are known: a bound has one value, or few.
            break
        offspring = task.points(*population.get("X").T)
        _assign(problem, population, offspring)
        algorithm.tell(infills=population)
        front = front_of(Points.join(front, offspring))
        progress((algorithm.n_gen - 1) / settings.generations)
    return front


def _gait_problem(bounds: Bounds) -> Problem:
    """Return the problem: decision vector [S, f] in its box, objectives [−v̄, P̄], one constraint (at most 0).

    The constraint excludes gaits that violate a limit or do not move. Gaits that do not move need the least power.
    They would therefore be Pareto-optimal in the problem as the paper states it.
    """
    return Problem(
        n_var=2,
        n_obj=2,
        n_ieq_constr=1,
        xl=np.array([bounds.stroke_low, bounds.frequency_low]),
        xu=np.array([bounds.stroke_high, bounds.frequency_high]),
    )


def _assign(problem: Problem, population: Population, points: Points) -> None:
    """Assign objectives and violations of evaluated gaits to the individuals of a population."""
    static = StaticProblem(
        problem,
        F=np.column_stack([-points.speed, points.power]),
        G=points.violation[:, np.newaxis],
    )
    Evaluator().eval(static, population)


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
