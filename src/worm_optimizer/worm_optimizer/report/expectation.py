# SPDX-License-Identifier: Apache-2.0
"""What the model expects of a gait, with 95 % intervals from the uncertainty of its parameters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from worm_model.gait import Gait
from worm_model.parameters import ParameterFile
from worm_model.simulation.batch import evaluate_gaits
from worm_model.simulation.simulator import (
    AVERAGED,
    CYCLES,
    GaitResult,
    cost_of_transport,
    evaluate_gait,
)
from worm_optimizer.robustness.uncertainty import phase_known, power_draws

SAMPLES = 500
SEED = 1
_STEADY = (CYCLES - AVERAGED + 1, CYCLES)
_TAIL = 2.5  # percent beyond each end of a 95 % interval


@dataclass(frozen=True)
class Band:
    """A ``value`` with bounds ``low`` and ``high`` in the same unit; NaN where there is none."""

    value: float
    low: float
    high: float

    def overlaps(self, other: Band) -> bool:
        """Whether both have a value in common."""
        return self.low <= other.high and other.low <= self.high


@dataclass(frozen=True)
class Bands:
    """``speed`` m/s along the gait's direction, ``power`` W, ``cost_of_transport`` 1."""

    speed: Band
    power: Band
    cost_of_transport: Band


@dataclass(frozen=True)
class Expectation:
    """Of a gait: ``nominal`` without its margin, ``robust`` with it, ``bands`` of the nominal one (95 %)."""

    nominal: GaitResult
    robust: GaitResult
    bands: Bands


def expect(gait: Gait, content: ParameterFile, averaged: tuple[int, int] = _STEADY) -> Expectation:
    """Predicts a gait from its command alone, at the groove phase of the parameter file.

    Over the ``averaged`` cycles (first and last, counted from 1): the first ones, which begin with straight fins,
    differ from those after; from the fifth on all are alike, and the last three of five stand for them.
    """
    first, last = averaged if averaged[1] < CYCLES else _STEADY
    count = last - first + 1
    unmargined = Gait(gait.stroke, gait.frequency, gait.direction)
    nominal = evaluate_gait(unmargined, content.parameters, last, count)
    draws = phase_known(content, SAMPLES, SEED).overrides
    overrides = {**draws, **power_draws(content, SAMPLES, SEED)}
    table = evaluate_gaits(
        gait.stroke,
        gait.frequency,
        direction=gait.direction,
        parameters=content.parameters,
        overrides=overrides,
        cycles=last,
        averaged=count,
    )
    mass = overrides["rear_mass"] + overrides["front_mass"]
    cost = cost_of_transport(table.speed, table.power, mass)
    return Expectation(
        nominal,
        evaluate_gait(gait, content.parameters, last, count),
        Bands(
            _band(nominal.speed, table.speed),
            _band(nominal.power, table.power),
            _band(nominal.cost_of_transport, cost),
        ),
    )


def _band(value: float, drawn: ArrayLike) -> Band:
    known = np.asarray(drawn, dtype=float)
    # A gait that stands still in some draws has an infinite cost there: no interpolation between the draws.
    low, high = np.percentile(known, (_TAIL, 100.0 - _TAIL), method="nearest")
    return Band(value, float(low), float(high))
