# SPDX-License-Identifier: Apache-2.0
"""The alarm for missed anchors from power alone: the gait with n and with n − 1 grooves a cycle, side by side.

The second hypothesis is the same gait with the least margin in the switching threshold that costs it a groove.
Each cycle gets a score, the projection of the measured power onto the difference of both predictions: 0 is
the prediction with n grooves, 1 that with n − 1. What the model gets wrong shifts the scores of a run alike, by
an amount that is known roughly (``BIAS``), what differs from cycle to cycle by less (``NOISE_W``). With every cycle
the probability of a miss is computed for all cycles remembered, over all patterns of misses, so that a
later cycle may tell that an earlier one was a miss. The first cycle, a transient, does not count. Where both
predictions hardly differ, power cannot tell, and says so; nor does it see a robot that misses in every cycle,
which looks like a model that is off.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import product

import numpy as np

from worm_model.gait import Gait
from worm_model.parameters import Parameters
from worm_model.simulation.simulator import SimulationError, evaluate_gait, simulate
from worm_model.twin.core.memory import PHASES

TRANSIENT = 6  # cycles before the predicted one
MARGIN_STEP = 0.0005  # m
MOST_MARGIN = 0.02  # m
LEAST_DIFFERENCE_W = 0.05  # rms of the difference, below which power cannot tell
FEWEST_SAMPLES = 20  # of a cycle
FIRST_CYCLE = 2  # that is judged
REMEMBERED = 7  # cycles that are judged together

# What scores are like, from runs of virtual robots whose parameters are not the model's (docs/twin.md).
BIAS, BIAS_SPREAD = 0.45, 0.3  # of all scores of a run: mean and standard deviation
EFFECT = 0.9  # of a miss
NOISE_W, LEAST_NOISE = (
    0.025,
    0.08,
)  # from cycle to cycle: over the rms of the difference; never below
MISS, MISS_AGAIN = 0.1, 0.5  # probability of a miss, and of one after another
ALARM = 0.9  # probability of a miss beyond which it is told


@dataclass(frozen=True)
class Hypotheses:
    """Predicted power of n grooves and its change with one fewer, in W at `PHASES` phases of a cycle.

    ``grooves`` n; ``margin`` in m that costs a groove, NaN if none does; ``difference_rms`` in W.
    """

    grooves: int
    margin: float
    expected: tuple[float, ...]
    difference: tuple[float, ...]

    @cached_property
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
class PowerScores:
    """The scores of the last cycles, each with its cycle's number.

    ``told`` are the cycles among them that an alarm was raised for; ``missed`` counts the alarms.
    """

    scores: tuple[tuple[int, float], ...] = ()
    told: frozenset[int] = frozenset()
    missed: int = 0


def close_cycle(
    before: PowerScores, cycle: int, power: np.ndarray, count: np.ndarray, pair: Hypotheses
) -> tuple[PowerScores, list[tuple[int, float]]]:
    """(the scores, cycles whose power is newly told to be that of a miss, with its probability) once a cycle is over.

    ``power`` (PHASES,) is the sum of what was measured in W at each phase, ``count`` (PHASES,) of how many samples.
    """
    difference = np.array(pair.difference)
    norm = float(np.sum(count * difference**2))
    if cycle < FIRST_CYCLE or count.sum() < FEWEST_SAMPLES or norm == 0.0:
        return before, []
    projection = float(np.sum((power - count * np.array(pair.expected)) * difference))
    scores = (*before.scores, (cycle, projection / norm))[-REMEMBERED:]
    probable = miss_probabilities([score for _, score in scores], pair.difference_rms)
    found = [
        (number, probability)
        for (number, _), probability in zip(scores, probable, strict=True)
        if probability > ALARM and number not in before.told
    ]
    told = (before.told | {number for number, _ in found}) & {number for number, _ in scores}
    return PowerScores(scores, told, before.missed + len(found)), found


def miss_probabilities(scores: Sequence[float], difference_rms: float) -> list[float]:
    """Probability of a miss in each of some cycles in a row, given their scores.

    The score of a cycle is taken as bias + EFFECT if missed + noise, the bias one for all cycles and normal,
    the noise normal, the misses a Markov chain; all 2^n patterns of misses are summed over.
    """
    count = len(scores)
    noise = max(LEAST_NOISE, NOISE_W / difference_rms) ** 2
    patterns = _patterns(count)
    rest = np.asarray(scores) - BIAS - EFFECT * patterns
    common = BIAS_SPREAD**2 / (noise + count * BIAS_SPREAD**2)
    squares = (np.sum(rest**2, axis=1) - common * np.sum(rest, axis=1) ** 2) / noise
    before = np.where(patterns[:, :-1] > 0.0, MISS_AGAIN, MISS)
    chance = np.hstack([np.full((len(patterns), 1), MISS), before])
    prior = np.sum(np.log(np.where(patterns > 0.0, chance, 1.0 - chance)), axis=1)
    weight = prior - 0.5 * squares
    weight = np.exp(weight - weight.max())
    probable: list[float] = (weight @ patterns / weight.sum()).tolist()
    return probable


@lru_cache(maxsize=REMEMBERED)
def _patterns(count: int) -> np.ndarray:
    """All patterns of misses (1) in a number of cycles, a row each."""
    return np.array(list(product((0.0, 1.0), repeat=count)))
