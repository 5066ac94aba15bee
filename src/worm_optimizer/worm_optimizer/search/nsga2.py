# SPDX-License-Identifier: Apache-2.0
"""NSGA-II as an iterator over generations: the caller owns the loop, reports and cancels as it likes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from pymoo.algorithms.moo.nsga2 import NSGA2

from worm_optimizer.search.pareto import front_of, hypervolume
from worm_optimizer.search.problem import assign, gait_problem
from worm_optimizer.search.task import OptimizerError, Points, Task


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
    problem = gait_problem(task.bounds)
    algorithm = NSGA2(pop_size=settings.population)
    termination = ("n_gen", settings.generations)
    algorithm.setup(problem, termination=termination, seed=settings.seed, verbose=False)
    seen: list[Points] = []
    evaluations = 0
    while algorithm.has_next():
        population = algorithm.ask()
        born = task.points(*population.get("X").T)
        assign(problem, population, born)
        algorithm.tell(infills=population)
        evaluations += len(born)
        front = front_of(Points.join(*seen, born))
        seen = [front]
        yield Generation(
            number=algorithm.n_gen - 1,
            of=settings.generations,
            evaluations=evaluations,
            front=front,
            hypervolume=hypervolume(front, reference_power),
        )
