# SPDX-License-Identifier: Apache-2.0
"""Prediction of a gait by the model, with 95 % intervals from the uncertainty of its parameters."""

from __future__ import annotations

import math
from dataclasses import asdict, astuple, dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from worm_model.arrays import Array
from worm_model.gait import AVERAGED, CYCLES, Gait
from worm_model.parameters import ParameterFile
from worm_model.simulation.batch import evaluate_gaits
from worm_model.simulation.simulator import GaitResult, cost_of_transport, evaluate_gait
from worm_optimizer.robustness.uncertainty import phase_known, power_draws, travel_described

SAMPLES = 500  # number of draws of the parameters
SEED = 1  # seed of these draws
# First and last averaged cycle of a run with the default number of cycles
_STEADY = (CYCLES - AVERAGED + 1, CYCLES)
_TAIL = 2.5  # percentage of the draws beyond each end of a 95 % interval
FEWEST_DRAWS = 10  # least number of draws with the same grooves from which a band is computed


@dataclass(frozen=True)
class Band:
    """Value with its bounds ``low`` and ``high``, all in the same unit; NaN if unavailable."""

    value: float
    low: float
    high: float

    def overlaps(self, other: Band) -> bool:
        """Return True if the two intervals overlap."""
        return self.low <= other.high and other.low <= self.high


@dataclass(frozen=True)
class Bands:
    """``speed`` along the gait's direction (m/s), ``power`` (W) and ``cost_of_transport`` (1)."""

    speed: Band
    power: Band
    cost_of_transport: Band


@dataclass(frozen=True)
class GrooveShare:
    """Number of ``grooves`` per cycle (mean over the averaged cycles), and its ``probability``."""

    grooves: float
    probability: float


@dataclass(frozen=True)
class Expectation:
    """Prediction of a gait.

    Attributes:
        nominal: prediction without the gait's margin.
        robust: prediction with the gait's margin.
        bands: speed, power and cost of transport without the margin, with their 95 % intervals. If the measured grooves
            are known, power and cost of transport are those of the draws that gain these grooves, see `_band_given`.
        grooves: grooves per cycle with their probabilities, the most probable first.
        cycles: number of averaged cycles.
        condition: condition under which intervals and probabilities hold, as text.
    """

    nominal: GaitResult
    robust: GaitResult
    bands: Bands
    grooves: tuple[GrooveShare, ...] = ()
    cycles: int = 0
    condition: str = ""


def expect(
    gait: Gait,
    content: ParameterFile,
    averaged: tuple[int, int] = _STEADY,
    measured_grooves: float = math.nan,
) -> Expectation:
    """Predict a gait from its command alone, at the groove phase of the parameter file.

    Args:
        gait: gait; its margin affects only the robust prediction.
        content: parameters with their intervals.
        averaged: first and last averaged cycle, counted from 1. The first cycles differ from later ones, because the
            fins are straight at the onset. If the last averaged cycle is the fifth or a later one, the last three of
            five cycles are predicted instead, because all later cycles are like the fifth.
        measured_grooves: measured grooves per cycle over the averaged cycles; NaN if not measured.
    """
    first, last = averaged if averaged[1] < CYCLES else _STEADY
    count = last - first + 1
    unmargined = replace(gait, margin=0.0)
    nominal = evaluate_gait(unmargined, content.parameters, last, count)
    draws = phase_known(content, SAMPLES, SEED).overrides
    overrides = {**draws, **power_draws(content, SAMPLES, SEED)}
    table = evaluate_gaits(
        **asdict(unmargined),
        parameters=content.parameters,
        overrides=overrides,
        cycles=last,
        averaged=count,
    )
    mass = overrides["rear_mass"] + overrides["front_mass"]
    cost = cost_of_transport(table.speed, table.power, mass)
    # Mean speed of a gait that gains one groove in all averaged cycles together, m/s
    step = content.parameters.pitch * gait.frequency / count
    totals = np.rint(np.asarray(table.speed) / step).astype(int)
    expected = round(nominal.speed / step)
    target = measured_grooves * count
    return Expectation(
        nominal,
        evaluate_gait(gait, content.parameters, last, count),
        Bands(
            _band(nominal.speed, table.speed),
            _band_given(target, totals, np.asarray(table.power), (expected, nominal.power)),
            _band_given(target, totals, np.asarray(cost), (expected, nominal.cost_of_transport)),
        ),
        _shares(totals, count),
        count,
        travel_described(content),
    )


def _shares(totals: NDArray[np.int64], count: int) -> tuple[GrooveShare, ...]:
    values, often = np.unique(totals, return_counts=True)
    shares = zip(values.tolist(), often.tolist(), strict=True)
    found = [GrooveShare(total / count, number / totals.size) for total, number in shares]
    return tuple(sorted(found, key=lambda share: -share.probability))


def _band_given(
    target: float, totals: NDArray[np.int64], drawn: Array, nominal: tuple[int, float]
) -> Band:
    """Return the band of the draws that gain the measured grooves.

    If too few draws gain them, the band is interpolated between the draws with fewer and those with more grooves.
    Numbers of grooves that fewer than `FEWEST_DRAWS` draws gain are ignored.

    Args:
        target: measured grooves in all averaged cycles together; NaN selects all draws.
        totals: grooves of each draw in all averaged cycles together, shape (n,).
        drawn: quantity of each draw, shape (n,).
        nominal: grooves and value of the nominal prediction.

    Returns:
        The band. It is NaN if it must be interpolated and draws with fewer or with more grooves are missing.
    """
    if math.isnan(target):
        return _band(nominal[1], drawn)
    values, often = np.unique(totals, return_counts=True)
    known = values[often >= min(FEWEST_DRAWS, totals.size)]
    if round(target) in known:
        same = drawn[totals == round(target)]
        return _band(nominal[1] if nominal[0] == round(target) else float(np.median(same)), same)
    below, above = known[known < target], known[known > target]
    if not (below.size and above.size):
        return Band(math.nan, math.nan, math.nan)
    less, more = int(below[-1]), int(above[0])
    share = (target - less) / (more - less)
    parts = [_band(float(np.median(d)), d) for d in (drawn[totals == less], drawn[totals == more])]
    bounds = (1.0 - share) * np.array(astuple(parts[0])) + share * np.array(astuple(parts[1]))
    return Band(*bounds.tolist())


def _band(value: float, drawn: ArrayLike) -> Band:
    known = np.asarray(drawn, dtype=float)
    # Draws without a groove have an infinite cost of transport, so the percentiles must not interpolate between draws.
    low, high = np.percentile(known, (_TAIL, 100.0 - _TAIL), method="nearest")
    return Band(value, float(low), float(high))
