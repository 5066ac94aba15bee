# SPDX-License-Identifier: Apache-2.0
"""Edges of the stroke: where a gait begins to gain another number of grooves per cycle.

Healthy robots lie on both sides of an edge that the model puts near their stroke. The twin therefore does not judge
whole grooves there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from worm_model.gait import Gait, GaitError
from worm_model.parameters import Parameters
from worm_model.simulation.batch import evaluate_gaits
from worm_msgs.gait import SHAPE

SCATTER_M = 0.00065  # standard deviation of the edge's stroke between healthy robots
NEAR = 2.0  # standard deviations of the stroke within which an edge is near
STEP_M = 0.00005  # resolution of the stroke


@dataclass(frozen=True)
class Edge:
    """Surroundings of a gait's stroke.

    Attributes:
        grooves: grooves per cycle of the gait.
        beyond: grooves per cycle beyond the nearest edge; equal to ``grooves`` if no edge is near.
        distance: stroke from the gait to this edge, m, positive if the edge is at a longer stroke; infinite if no edge
            is near.
    """

    grooves: int
    beyond: int
    distance: float = math.inf

    @property
    def is_near(self) -> bool:
        """True if a healthy robot may lie on the other side of the edge."""
        return self.beyond != self.grooves

    def chance(self, predicted: int, gained: int) -> float:
        """Return the probability that a healthy robot gains other grooves than ``predicted``; 0 if no edge is near.

        Both numbers are grooves of a cycle along the gait's direction.
        """
        if not self.is_near or gained == predicted or gained not in (self.grooves, self.beyond):
            return 0.0
        other_side = 0.5 * math.erfc(abs(self.distance) / (SCATTER_M * math.sqrt(2.0)))
        return other_side if gained == self.beyond else 1.0 - other_side

    @property
    def text(self) -> str:
        """Message for the operator."""
        side = "below" if self.distance > 0.0 else "above"
        least, most = sorted((self.grooves, self.beyond))
        return (
            f"the stroke is {1e3 * abs(self.distance):.1f} mm {side} the edge to {self.beyond} grooves per cycle: a "
            f"healthy robot gains {least} or {most}, so whole grooves are not judged"
        )


def edge_of(gait: Gait, parameters: Parameters) -> Edge:
    """Return the edge near a gait without its margin, for a robot with the run's L0."""
    # A rounded L0 makes runs share their cached edges. It moves the edge by at most 0.06 mm.
    length = round(parameters.initial_length, 4)
    return _edge_of(replace(gait, margin=0.0), parameters.replace(initial_length=length))


@lru_cache(maxsize=32)
def _edge_of(gait: Gait, parameters: Parameters) -> Edge:
    count = math.ceil(NEAR * SCATTER_M / STEP_M)
    steps = np.arange(-count, count + 1)
    strokes = gait.stroke + steps * STEP_M
    shape = {name: getattr(gait, name) for name in SHAPE}
    try:
        table = evaluate_gaits(
            strokes, gait.frequency, direction=gait.direction, parameters=parameters, **shape
        )
    except GaitError:  # the body is too short for a stroke as long as this
        return Edge(0, 0)
    counts = np.nan_to_num(table.min_grooves).round().astype(int)
    own = int(counts[count])
    others = steps[counts != own]
    if not others.size:
        return Edge(own, own)
    nearest = int(others[np.argmin(np.abs(others))])
    return Edge(own, int(counts[count + nearest]), float(nearest * STEP_M))
