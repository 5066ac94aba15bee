# SPDX-License-Identifier: Apache-2.0
"""Edges: strokes, or thresholds of the fins, at which a gait begins to gain another number of grooves per cycle.

Healthy robots lie on both sides of an edge that the model puts near them. The twin therefore does not judge whole
grooves there. A longer stroke and a lower threshold bring the rear fin to the same edge. The edge of the front fin (the
margin's cliff) does not depend on the stroke. The stroke is the commanded one and, where an instrument measures the
length, also the one that the body performs: a compliant cable makes it shorter.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from worm_model.arrays import Array
from worm_model.gait import Gait, GaitError
from worm_model.parameters import Parameters
from worm_model.simulation.actuation import length_change_of_command
from worm_model.simulation.batch import evaluate_gaits
from worm_model.simulation.closed_form import deflected_share
from worm_model.twin.core.memory import PHASES
from worm_msgs.gait import SHAPE

SCATTER_M = 0.00065  # standard deviation of the edge's stroke between healthy robots
NEAR = 2.0  # standard deviations of the stroke within which an edge is near
STEP_M = 0.00005  # resolution of the stroke
EXTREME = 0.1  # parts of a cycle whose length is within this share of the span from an extreme count as extreme


@dataclass(frozen=True)
class Edge:
    """Surroundings of a gait's stroke.

    Attributes:
        grooves: grooves per cycle of the gait.
        beyond: grooves per cycle beyond the nearest edge; equal to ``grooves`` if no edge is near.
        distance: stroke from the gait to this edge, m, positive if the edge is at a longer stroke; infinite if no edge
            is near.
        of_threshold: True if only another threshold of the fins reaches the edge. The distance is that of a stroke with
            the same effect on the rear fin.
    """

    grooves: int
    beyond: int
    distance: float = math.inf
    of_threshold: bool = False

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
        least, most = sorted((self.grooves, self.beyond))
        usual = f": a healthy robot gains {least} or {most}, so whole grooves are not judged"
        beyond = f"the edge to {self.beyond} groove{'' if self.beyond == 1 else 's'}"
        if self.of_threshold:
            return f"the thresholds of the fins are near {beyond} at this groove phase{usual}"
        side = "below" if self.distance > 0.0 else "above"
        return f"{1e3 * abs(self.distance):.1f} mm {side} {beyond}{usual}"


def edge_of(gait: Gait, parameters: Parameters) -> Edge:
    """Return the edge near a gait without its margin, for a robot with the run's L0."""
    # The rounded stroke and L0 move the edge by at most 0.1 mm together.
    rounded = replace(gait, stroke=round(gait.stroke, 4), margin=0.0)
    return _edge_of(rounded, with_rounded_length(parameters))


@lru_cache(maxsize=32)
def with_rounded_length(parameters: Parameters) -> Parameters:
    """Return parameters with a rounded L0, so that cycles and runs share the edges and signatures cached for them.

    Both hardly depend on a change by 0.05 mm.
    """
    return parameters.replace(initial_length=round(parameters.initial_length, 4))


def edge_of_body(gait: Gait, parameters: Parameters, residuals: Array) -> Edge:
    """Return the edge near the stroke that the body performs in a cycle.

    ``residuals`` (PHASES,) are the residuals of the length in m, measured minus computed from the command, and NaN
    where nothing was measured. Without measurements at both extremes, the edge is that of the commanded stroke.
    """
    shorter = sum(
        sign * np.nanmean(residuals[where]) if np.isfinite(residuals[where]).any() else np.nan
        for sign, where in zip(
            (1.0, -1.0), _extremes(replace(gait, margin=0.0), parameters), strict=True
        )
    )
    if not np.isfinite(shorter):
        return edge_of(gait, parameters)
    return edge_of(replace(gait, stroke=gait.stroke - float(shorter) / parameters.gain), parameters)


@lru_cache(maxsize=32)
def _extremes(gait: Gait, parameters: Parameters) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return masks (PHASES,) of the phases of a cycle at which the body is shortest, and longest."""
    times = (
        (np.arange(2 * PHASES) + 0.5) / PHASES * gait.period
    )  # after one cycle the response repeats itself
    change = length_change_of_command(times, gait.command(times), parameters)[PHASES:]
    share = (change - change.min()) / np.ptp(change)
    return share <= EXTREME, share >= 1.0 - EXTREME


@lru_cache(maxsize=64)
def _edge_of(gait: Gait, parameters: Parameters) -> Edge:
    count = math.ceil(NEAR * SCATTER_M / STEP_M)
    shifts = STEP_M * np.arange(-count, count + 1)
    by_stroke = parameters.gain * deflected_share(parameters)
    threshold = parameters.switching_threshold - shifts * by_stroke
    shape = {name: getattr(gait, name) for name in SHAPE}
    try:
        table = evaluate_gaits(
            np.array([gait.stroke + shifts, np.full_like(shifts, gait.stroke)]),
            gait.frequency,
            direction=gait.direction,
            parameters=parameters,
            overrides={
                "switching_threshold": [
                    np.full_like(shifts, parameters.switching_threshold),
                    threshold,
                ]
            },
            **shape,
        )
    except GaitError:  # the body is too short for a stroke as long as this
        return Edge(0, 0)
    grooves = np.nan_to_num(table.min_grooves).round().astype(int)
    own = int(grooves[0, count])
    for axis, counts in enumerate(grooves):
        others = np.flatnonzero(counts != own)
        if others.size:
            nearest = others[np.argmin(np.abs(shifts[others]))]
            return Edge(own, int(counts[nearest]), float(shifts[nearest]), bool(axis))
    return Edge(own, own)
