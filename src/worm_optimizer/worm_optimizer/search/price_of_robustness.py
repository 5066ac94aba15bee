# SPDX-License-Identifier: Apache-2.0
"""The price of robustness: the optimal cost of transport over the margin δ_m, and its cliff.

Each margin's optimum is read from the exhaustive map's front, the true one, so that a bend of the curve
is the robot's and not the search's.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from worm_model.parameters import Parameters
from worm_model.simulation import closed_form
from worm_model.simulation.simulator import cost_of_transport
from worm_optimizer.search.gait_map import MapSettings, branches_of, build_map
from worm_optimizer.search.optimizer_errors import OptimizerError
from worm_optimizer.search.task import MarginTask

CLIFF_RISE = 1.25
CLIFF_RULE = (
    "the cliff is the last margin before the first step over which the branch (grooves per cycle) with "
    f"the lowest cost of transport is lost and the lowest cost of transport rises by a factor of {CLIFF_RISE} "
    "or more; a step after which no gait moves counts as one"
)


@dataclass(frozen=True)
class MarginPoint:
    """The certified front of one margin in a few numbers; NaN and 0 where no gait moves.

    ``margin`` in m; ``cost_of_transport`` is the optimum, reached at ``stroke`` m and ``frequency`` Hz on
    ``branch`` (grooves per cycle); ``branches`` are those of the front; ``max_speed`` in m/s and
    ``min_power`` in W are its ends.
    """

    margin: float
    cost_of_transport: float
    stroke: float
    frequency: float
    branch: int
    branches: tuple[int, ...]
    max_speed: float
    min_power: float


@dataclass(frozen=True)
class Cliff:
    """Where robustness begins to cost: the last margin before and the first after, in m.

    ``rise`` is the factor of the optimal cost of transport (infinite: no gait moves after it) and
    ``lost_branch`` the grooves per cycle of the branch that is lost.
    """

    margin: float
    after: float
    rise: float
    lost_branch: int


@dataclass(frozen=True)
class PriceOfRobustness:
    """The whole scan. ``cliff`` is None where the scanned margins hold none."""

    points: tuple[MarginPoint, ...]
    cliff: Cliff | None
    closed_form_cliff_margin: float
    groove_phase: float

    @property
    def margin(self) -> float:
        """The margin to choose in m: at the cliff, or the greatest at which a gait moves.

        Raises `OptimizerError` if no gait moves at any margin.
        """
        if self.cliff is not None:
            return self.cliff.margin
        moving = [point.margin for point in self.points if point.branch]
        if not moving:
            raise OptimizerError(
                "no gait within the bounds moves at any margin of the scan: "
                "lower the margins, relax the limits or allow longer strokes"
            )
        return max(moving)


def scan(
    task: MarginTask, resolution: MapSettings, margins: Iterable[float]
) -> Iterator[MarginPoint]:
    """Maps the box at each margin in m, one item a margin."""
    for margin in margins:
        front = build_map(task.with_margin(float(margin)), resolution).front
        if not len(front):
            nothing = math.nan
            yield MarginPoint(float(margin), nothing, nothing, nothing, 0, (), nothing, nothing)
            continue
        cost = cost_of_transport(front.speed, front.power, task.parameters.mass)
        best = int(np.argmin(cost))
        yield MarginPoint(
            margin=float(margin),
            cost_of_transport=float(cost[best]),
            stroke=float(front.stroke[best]),
            frequency=float(front.frequency[best]),
            branch=int(front.branch[best]),
            branches=branches_of(front),
            max_speed=float(front.speed.max()),
            min_power=float(front.power.min()),
        )


def find_cliff(points: Sequence[MarginPoint]) -> Cliff | None:
    """The cliff of a scan by `CLIFF_RULE`; None if there is none. ``points`` by rising margin."""
    for before, after in itertools.pairwise(points):
        if not before.branch or before.branch in after.branches:
            continue
        rise = after.cost_of_transport / before.cost_of_transport if after.branch else math.inf
        if rise >= CLIFF_RISE:
            return Cliff(before.margin, after.margin, rise, before.branch)
    return None


def price_of_robustness(points: Sequence[MarginPoint], parameters: Parameters) -> PriceOfRobustness:
    """Puts a finished scan together with its cliff and with the closed form's."""
    return PriceOfRobustness(
        points=tuple(points),
        cliff=find_cliff(points),
        closed_form_cliff_margin=closed_form.cliff_margin(parameters),
        groove_phase=closed_form.groove_phase(parameters),
    )
