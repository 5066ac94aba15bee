# SPDX-License-Identifier: Apache-2.0
"""The optimisation problem (eq:moo_formulation) in the form that pymoo takes."""

from __future__ import annotations

import numpy as np
from pymoo.core.evaluator import Evaluator
from pymoo.core.population import Population
from pymoo.core.problem import Problem
from pymoo.problems.static import StaticProblem

from worm_optimizer.search.task import Bounds, Points


def gait_problem(bounds: Bounds) -> Problem:
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


def assign(problem: Problem, population: Population, points: Points) -> None:
    """Gives the individuals of a population the objectives and the violation of their gaits."""
    static = StaticProblem(
        problem,
        F=np.column_stack([-points.speed, points.power]),
        G=points.violation[:, np.newaxis],
    )
    Evaluator().eval(static, population)
