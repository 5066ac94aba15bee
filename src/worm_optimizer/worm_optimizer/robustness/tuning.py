# SPDX-License-Identifier: Apache-2.0
"""Next gait for a requested probability to keep the grooves, from the measured margins of the runs so far.

The margins of both fins are linear in the gait, about the gaits that were run (`MarginModel`). A longer stroke gives
the rear fin more margin. It gives the front one none: above some frequency the cable, which cannot push, leaves the
bellows too little time to extend the body, and only a lower frequency helps. So a tuned gait has the smallest stroke
with the requested probability, at the frequency of the last run or the highest one below at which the front fin has its
margin.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from worm_model.gait import FREQUENCY_RANGE, Gait
from worm_model.margin.half_cycles import Fin
from worm_model.margin.keeping import (
    MarginBelief,
    MarginModel,
    Probability,
    keeps_probability,
)
from worm_model.margin.measured_margin import RunMargin
from worm_model.parameters import Parameters
from worm_model.simulation.closed_form import deflected_share
from worm_optimizer.evaluation.command_shape import shapes_of_gaits
from worm_optimizer.evaluation.task import MarginTask

_STEP_M = 0.0005  # of the stroke
# of the stroke: up to this difference from a run, a gait needs no run of its own, as the change of its margin is known
# to 0.2 mm
_SAME_M = 0.0015
_RESERVE_M = (
    0.0003  # of the stroke, more than the probability needs, so that a next run confirms it
)
_REAR_SHARE = 0.1  # of the lost cycles, for the rear fin where the front fin lacks margin
_SLOWER = 0.98  # step of the frequency
_SLOWEST_STEP = 0.6  # of the frequency from one run to the next
_UNCERTAIN_M = 0.003  # negative rear margin that can be one of the front fin
_WORTHWHILE_M = 0.0005  # increase of the front margin for which a lower frequency is tried
_ALIKE = 0.05  # difference of probabilities below which they are alike
_HOPELESS = 0.05  # probability below which the gaits of the runs lose about every groove
# standard deviation of the prior of the margin of the first gait: it is measured
_MEASURED_OFFSET_M = 0.05
# m per unit of ln f, change of the margin with the frequency and its standard deviation. The front margin changes only
# above the corner, from which the bellows has too little time to extend the body. Values of robots whose cable cannot
# push, between 0.1 and 0.4 Hz.
_REAR_BY_FREQUENCY = (-0.001, 0.002)
_FRONT_BY_FREQUENCY = (-0.010, 0.004)
_CORNER = 0.18  # corner frequency times c_b/k_b
# relative standard deviation of the change of the rear margin with the stroke
_BY_STROKE_SHARE = 0.15
# change of the front margin with the stroke, and its standard deviation
_FRONT_BY_STROKE = (-0.05, 0.03)
# relative standard deviation of the change of the front margin with the pretension
_FRONT_BY_PRETENSION = 0.3


class TuneState(enum.Enum):
    """Outcome: run the gait and measure, the gait has the probability, or no gait has it.

    A gait that has it is that of the last run, with a stroke that is up to `_SAME_M` shorter where this suffices. If no
    gait has it, the gait is the best of the runs.
    """

    RUN = "run"
    DONE = "done"
    IMPOSSIBLE = "impossible"


@dataclass(frozen=True)
class Tuning:
    """Outcome of a step: a gait as `TuneState` says, its expected probability, and the reason."""

    state: TuneState
    gait: Gait
    keeps: Probability
    reason: str


@dataclass(frozen=True)
class GaitLimits:
    """Largest stroke (m) as a function of a gait, whose own stroke does not count, and the lowest frequency (Hz)."""

    largest_stroke: Callable[[Gait], float]
    lowest_frequency: float = FREQUENCY_RANGE[0]


def limits_of(task: MarginTask) -> GaitLimits:
    """Return the limits of a task: its box, and the limits of its actuators."""
    strokes = np.arange(task.bounds.stroke_low, task.bounds.stroke_high + 1e-9, _STEP_M)

    def largest_stroke(gait: Gait) -> float:
        tried = strokes[strokes + gait.pretension <= task.bounds.stroke_high + 1e-9]
        shape = shapes_of_gaits([gait] * tried.size)
        within = tried[task.excess(tried, np.full(tried.size, gait.frequency), shape) <= 0.0]
        return float(within.max(initial=0.0))

    return GaitLimits(largest_stroke, task.bounds.frequency_low)


@dataclass(frozen=True)
class _Knowledge:
    """Margins of all runs as linear models about the gait of the last run."""

    models: dict[Fin, MarginModel]
    gaits: tuple[Gait, ...]
    corner: float  # Hz

    @property
    def about(self) -> Gait:
        return self.gaits[-1]

    @property
    def best(self) -> Gait:
        """Gait of the runs that keeps its grooves with the highest probability, of alike ones the last.

        The last one was chosen after more measurements.
        """
        kept = [self.keeps(gait).value for gait in self.gaits]
        alike = [
            gait for gait, each in zip(self.gaits, kept, strict=True) if each > max(kept) - _ALIKE
        ]
        return alike[-1]

    def beliefs(self, gait: Gait) -> dict[Fin, MarginBelief]:
        return {
            fin: model.at(_terms(fin, gait, self.about, self.corner))
            for fin, model in self.models.items()
        }

    def keeps(self, gait: Gait) -> Probability:
        return keeps_probability(*self.beliefs(gait).values())


def next_gait(
    runs: Sequence[RunMargin], probability: float, limits: GaitLimits, parameters: Parameters
) -> Tuning | None:
    """Return the next step of tuning, None if the last run was not measured.

    Both fins must be measured, unless the front one lacks margin, so that a lower frequency is needed anyway.

    Args:
        runs: measured margins of the runs so far, the last one last, all for the same number of grooves.
        probability: requested probability that a cycle keeps its grooves.
        limits: limits of the robot.
        parameters: parameters of the robot; approximate ones suffice.
    """
    front = runs[-1].beliefs.get(Fin.FRONT) if runs else None
    if front is None or (runs[-1].keeps is None and front.expected > 0.0):
        return None
    return _next(_knowledge(runs, parameters), probability, limits)


def _next(known: _Knowledge, probability: float, limits: GaitLimits) -> Tuning:
    last = known.about
    keeps, smallest = known.keeps(last), _smallest_stroke(known, last, limits, probability, *Fin)
    if smallest is None:
        return _slower(known, probability, limits)
    if keeps.value < probability:
        reserve = min(smallest.stroke + _RESERVE_M, limits.largest_stroke(smallest))
        return _run(known, replace(smallest, stroke=reserve), _margins(known, last))
    if last.stroke - smallest.stroke > _SAME_M:
        return _run(known, smallest, "a shorter stroke has the probability, too")
    shorter = replace(last, stroke=min(smallest.stroke + _RESERVE_M, last.stroke))
    return _outcome(TuneState.DONE, known, shorter, _margins(known, last))


def _slower(known: _Knowledge, probability: float, limits: GaitLimits) -> Tuning:
    """Return the gait at the highest lower frequency with the probability, or the next one towards it."""
    last = gait = known.about
    lowest = max(_SLOWEST_STEP * last.frequency, limits.lowest_frequency)
    reason = f"{_margins(known, last)}; a longer stroke does not help"
    while gait.frequency > lowest:
        gait = replace(gait, frequency=max(_SLOWER * gait.frequency, lowest))
        found = _smallest_stroke(known, gait, limits, probability, *Fin)
        if found is not None:
            return _run(known, found, reason)
    relaxed = _less_pretension(known, limits, probability)
    if relaxed is not None:
        return _run(known, relaxed, f"{_margins(known, last)}; less pretension helps the front fin")
    # Also where the rear fin seems to lack a little: of a lost groove, the fin that lost it is not certain.
    farthest = replace(last, stroke=limits.largest_stroke(last))
    lacks = known.beliefs(farthest)[Fin.REAR].expected < -_UNCERTAIN_M
    if _gain_of_front(known, gait) > _WORTHWHILE_M and not lacks:
        stroke = min(gait.stroke, limits.largest_stroke(gait))
        return _run(known, replace(gait, stroke=stroke), reason)
    # The front fin loses the cycles that may be lost, so the rear one, which a longer stroke helps, loses few of them.
    almost = 1.0 - _REAR_SHARE * (1.0 - probability)
    fitting = _smallest_stroke(known, last, limits, almost, Fin.REAR)
    if fitting is not None and abs(fitting.stroke - last.stroke) > _SAME_M:
        return _run(known, fitting, _margins(known, last))
    reason = f"{reason} within the limits, nor a slower gait"
    if max(known.keeps(each).value for each in known.gaits) < _HOPELESS:
        reason += "; start from another gait, such as that of --objective min_power"
    return _outcome(TuneState.IMPOSSIBLE, known, known.best, reason)


def _less_pretension(known: _Knowledge, limits: GaitLimits, probability: float) -> Gait | None:
    """Return the gait with the largest lower pretension that has the probability, None if none has it."""
    last = known.about
    for less in np.arange(_STEP_M, last.pretension + 1e-9, _STEP_M):
        trial = replace(last, pretension=round(max(last.pretension - float(less), 0.0), 5))
        found = _smallest_stroke(known, trial, limits, probability, *Fin)
        if found is not None:
            return found
    return None


def _gain_of_front(known: _Knowledge, gait: Gait) -> float:
    """Return the increase (m) of the front margin from the last run's gait to another one."""
    before, after = (known.beliefs(each)[Fin.FRONT].expected for each in (known.about, gait))
    return after - before


def _smallest_stroke(
    known: _Knowledge, gait: Gait, limits: GaitLimits, probability: float, *fins: Fin
) -> Gait | None:
    """Return the gait with the smallest stroke at which the fins have the probability, None if none has it."""
    for stroke in np.arange(0.3 * gait.stroke, limits.largest_stroke(gait) + 1e-9, _STEP_M):
        trial = replace(gait, stroke=float(stroke))
        beliefs = known.beliefs(trial)
        if math.prod(beliefs[fin].chance for fin in fins) >= probability:
            return trial
    return None


def _run(known: _Knowledge, gait: Gait, reason: str) -> Tuning:
    return _outcome(TuneState.RUN, known, gait, reason)


def _outcome(state: TuneState, known: _Knowledge, gait: Gait, reason: str) -> Tuning:
    gait = replace(gait, stroke=round(gait.stroke, 5), frequency=round(gait.frequency, 4))
    return Tuning(state, gait, known.keeps(gait), reason)


def _margins(known: _Knowledge, gait: Gait) -> str:
    """Return the expected margins of both fins as text."""
    return ", ".join(f"{fin.value} {belief}" for fin, belief in known.beliefs(gait).items())


def _knowledge(runs: Sequence[RunMargin], parameters: Parameters) -> _Knowledge:
    about = runs[-1].gait
    p = parameters
    corner = _CORNER * p.bellows_stiffness / p.bellows_damping
    by_stroke = p.gain * deflected_share(p)
    priors = {
        Fin.REAR: ([by_stroke], [_BY_STROKE_SHARE * by_stroke]),
        Fin.FRONT: (
            [_FRONT_BY_STROKE[0], -by_stroke],
            [_FRONT_BY_STROKE[1], _FRONT_BY_PRETENSION * by_stroke],
        ),
    }
    models = {}
    for fin, (expected, spread) in priors.items():
        used = _informative(runs, fin)
        margins = [run.margins(fin) for run in used]
        terms = [
            np.tile(_terms(fin, run.gait, about, corner), (margin.size, 1))
            for run, (margin, _, _) in zip(used, margins, strict=True)
        ]
        slope, slope_sd = _REAR_BY_FREQUENCY if fin is Fin.REAR else _FRONT_BY_FREQUENCY
        margin, sds, place = (np.concatenate(columns) for columns in zip(*margins, strict=True))
        models[fin] = MarginModel(
            margin,
            sds,
            place,
            np.concatenate(terms),
            np.array([0.0, slope, *expected]),
            np.array([_MEASURED_OFFSET_M, slope_sd, *spread]),
        )
    return _Knowledge(models, tuple(run.gait for run in runs), corner)


def _informative(runs: Sequence[RunMargin], fin: Fin) -> list[RunMargin]:
    """Return the last run, and the earlier ones that show the margin of a fin.

    A run that never gains its grooves does not show which fin loses one. Where the front fin loses some, the rear fin
    begins its next stroke elsewhere.
    """

    def shows(run: RunMargin) -> bool:
        front = run.beliefs.get(Fin.FRONT)
        keeps = fin is Fin.FRONT or (front is not None and front.expected > 0.0)
        return run.shows_losing_fin and keeps

    return [*filter(shows, runs[:-1]), runs[-1]]


def _terms(fin: Fin, gait: Gait, about: Gait, corner: float) -> list[float]:
    """Return the terms of a gait on which the margin of a fin depends linearly, zero but the first for ``about``."""
    if fin is Fin.REAR:
        return [1.0, math.log(gait.frequency / about.frequency), gait.reach - about.reach]
    faster = math.log(max(gait.frequency, corner) / max(about.frequency, corner))
    return [1.0, faster, gait.stroke - about.stroke, gait.pretension - about.pretension]
