# SPDX-License-Identifier: Apache-2.0
"""The alarm for missed anchors from power alone: the gait with n and with n − 1 grooves a cycle, side by side.

The second hypothesis is the same gait with the least margin in the switching threshold that costs it a groove.
Each cycle gets a score, the projection of the measured power onto the difference of both predictions: 0 is
the prediction with n grooves, 1 that with n − 1. What the model gets wrong shifts the score of every
cycle alike, so a cycle is compared with the median of the run's cycles before it; the first cycle, a
transient, does not count. Where both predictions hardly differ, power cannot tell, and says so.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from statistics import median

import numpy as np

from worm_model.gait import Gait
from worm_model.parameters import Parameters
from worm_model.simulator import SimulationError, evaluate_gait, simulate
from worm_model.twin_anchors import Cycle

PHASES = 200  # of a cycle at which both predictions are kept
TRANSIENT = 6  # cycles before the predicted one
MARGIN_STEP = 0.0005  # m
MOST_MARGIN = 0.02  # m
LEAST_DIFFERENCE_W = 0.05  # rms of the difference, below which power cannot tell
FEWEST_SAMPLES = 20  # of a cycle
FEWEST_CYCLES = 2  # before a cycle that it is compared with
REMEMBERED = 15  # scores
ALARM = 0.4  # above the median


@dataclass(frozen=True)
class Hypotheses:
    """Predicted power of n grooves and its change with one fewer, in W at `PHASES` phases of a cycle.

    ``grooves`` n; ``margin`` in m that costs a groove, NaN if none does; ``difference_rms`` in W.
    """

    grooves: int
    margin: float
    expected: tuple[float, ...]
    difference: tuple[float, ...]

    @property
    def difference_rms(self) -> float:
        """W."""
        return math.sqrt(sum(value * value for value in self.difference) / PHASES)

    @property
    def telling(self) -> bool:
        """Whether power can tell a missed groove at all."""
        return self.difference_rms >= LEAST_DIFFERENCE_W


@lru_cache(maxsize=8)
def hypotheses(gait: Gait, parameters: Parameters) -> Hypotheses:
    """Both predictions for a gait, played without margin; some milliseconds the first time."""
    nominal = replace(gait, margin=0.0)
    flat = (0.0,) * PHASES
    try:
        expected = _steady_power(nominal, parameters)
        grooves = _grooves(nominal, parameters)
        steps = np.arange(MARGIN_STEP, MOST_MARGIN, MARGIN_STEP).tolist()
        poorer = (replace(gait, margin=step) for step in steps)
        missing = next((g for g in poorer if _grooves(g, parameters) < grooves), None)
        if grooves < 1 or missing is None:
            return Hypotheses(grooves, math.nan, tuple(expected.tolist()), flat)
        difference = _steady_power(missing, parameters) - expected
    except SimulationError:
        return Hypotheses(0, math.nan, flat, flat)
    return Hypotheses(grooves, missing.margin, tuple(expected.tolist()), tuple(difference.tolist()))


def _grooves(gait: Gait, parameters: Parameters) -> int:
    return round(evaluate_gait(gait, parameters, TRANSIENT + 1, 1).grooves_per_cycle)


def _steady_power(gait: Gait, parameters: Parameters) -> np.ndarray:
    phases = (np.arange(PHASES) + 0.5) / PHASES
    trajectory = simulate(gait, parameters, TRANSIENT + 1)
    power: np.ndarray = trajectory.at((TRANSIENT + phases) * gait.period).power
    return power


@dataclass(frozen=True)
class PowerWatch:
    """Sums of the running cycle and the scores of those before; ``missed`` counts the alarms."""

    cycle: int = 1
    projection: float = 0.0
    norm: float = 0.0
    samples: int = 0
    scores: tuple[float, ...] = ()
    missed: int = 0


def observe_power(
    watch: PowerWatch, cycle: Cycle, power: float, pair: Hypotheses
) -> tuple[PowerWatch, str]:
    """(watch, alarm or nothing) with a power sample (W) in a cycle."""
    text = ""
    if cycle.number > watch.cycle:
        watch, text = _close(watch, cycle.number)
    k = min(int(cycle.phase * PHASES), PHASES - 1)
    difference = pair.difference[k]
    watch = replace(
        watch,
        projection=watch.projection + (power - pair.expected[k]) * difference,
        norm=watch.norm + difference * difference,
        samples=watch.samples + 1,
    )
    return watch, text


def _close(watch: PowerWatch, next_cycle: int) -> tuple[PowerWatch, str]:
    ended = PowerWatch(next_cycle, scores=watch.scores, missed=watch.missed)
    if watch.cycle == 1 or watch.samples < FEWEST_SAMPLES or watch.norm == 0.0:
        return ended, ""
    score = watch.projection / watch.norm
    usual = median(watch.scores) if len(watch.scores) >= FEWEST_CYCLES else math.nan
    ended = replace(ended, scores=(*watch.scores, score)[-REMEMBERED:])
    if not score - usual > ALARM:
        return ended, ""
    text = (
        f"cycle {watch.cycle}: its power is that of a missed groove "
        f"(score {score:.2f}, usually {usual:.2f}; 0 is none missed, 1 is one)"
    )
    return replace(ended, missed=watch.missed + 1), text
