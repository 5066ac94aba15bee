# SPDX-License-Identifier: Apache-2.0
"""NSGA-II as an iterator over generations: the caller owns the loop, reports and cancels as it likes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from pymoo.algorithms.moo.nsga2 import NSGA2
from pymoo.core.evaluator import Evaluator
from pymoo.core.population import Population
from pymoo.core.problem import Problem
from pymoo.problems.static import StaticProblem

from worm_optimizer.search.optimizer_errors import OptimizerError
from worm_optimizer.search.pareto import front_of, hypervolume
from worm_optimizer.search.task import Bounds, Points, Task


@dataclass(frozen=True)
class SearchSettings:
    """NSGA-II's population and generations, and the seed of all its randomness."""

    population: int = 100
    generations: int = 100
    seed: int = 1

    def __post_init__(self) -> None:
        if not (4 <= self.population <= 100_000 and 1 <= self.generations <= 100_000):
            raise OptimizerError(
                f"search: population {self.population} and generations {self.generations}: "
                "give a population of at least 4 and at least 1 generation, both at most 100000"
            )
        if not 0 <= self.seed < 2**32:
            raise OptimizerError(f"search: seed {self.seed}: give one from 0 to {2**32 - 1}")


@dataclass(frozen=True)
class Generation:
    """Where the search stands after a generation.

    ``front`` holds the best of all gaits evaluated so far, not only of the living population, by rising
    speed; ``hypervolume`` is its area in m/s·W (`pareto.hypervolume`).
    """

    number: int
    of: int
    evaluations: int
    front: Points
    hypervolume: float


def generations(
    task: Task, settings: SearchSettings, reference_power: float
) -> Iterator[Generation]:
    """Runs NSGA-II on a task, one item a generation; the same seed gives the same fronts.

    ``reference_power`` in W is the corner of the reported hypervolume.
    """
    problem = _gait_problem(task.bounds)
    algorithm = NSGA2(pop_size=settings.population)
    termination = ("n_gen", settings.generations)
    algorithm.setup(problem, termination=termination, seed=settings.seed, verbose=False)
    best: list[Points] = []
    evaluations = 0
    while algorithm.has_next():
        population = algorithm.ask()
        born = task.points(*population.get("X").T)
        _assign(problem, population, born)
        algorithm.tell(infills=population)
        evaluations += len(born)
        front = front_of(Points.join(*best, born))
        best = [front]
        yield Generation(
            number=algorithm.n_gen - 1,
            of=settings.generations,
            evaluations=evaluations,
            front=front,
            hypervolume=hypervolume(front, reference_power),
        )


def _gait_problem(bounds: Bounds) -> Problem:
    """Decision vector [S, f] in its box, objectives [−v̄, P̄], one constraint (at most 0).

    The constraint keeps gaits that stand still out: they need the least power, so they would be
    Pareto-optimal in the problem as printed.
    """
    return Problem(
        n_var=2,
        n_obj=2,
        n_ieq_constr=1,
        xl=np.array([bounds.stroke_low, bounds.frequency_low]),
        xu=np.array([bounds.stroke_high, bounds.frequency_high]),
    )


def _assign(problem: Problem, population: Population, points: Points) -> None:
    """Gives the individuals of a population the objectives and the violation of their gaits."""
    static = StaticProblem(
        problem,
        F=np.column_stack([-points.speed, points.power]),
        G=points.violation[:, np.newaxis],
    )
    Evaluator().eval(static, population)
