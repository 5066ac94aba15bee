# SPDX-License-Identifier: Apache-2.0
"""Whether parameters walk away from bag to bag: control charts of estimates, one a bag, in the order of time.

Charts for individual measurements with sensitizing rules, as in D. C. Montgomery, Introduction to Statistical
Quality Control (chapters on Shewhart charts and on individual measurements).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from worm_model.arrays import Array
from worm_model.identification.estimate import Estimate, quantile
from worm_model.parameters import ParameterFile

FEWEST_BAGS = 5  # from which moving ranges make limits
ONE_SIDE = 8  # bags in a row on one side of the centre
MONOTONE = 6  # bags in a row, each above, or each below, the one before
SIGMAS = 3.0  # from the centre to a limit
INDIVIDUALS = 2.66  # SIGMAS / 1.128: from the mean moving range of two to a limit


class State(str, Enum):
    """What a chart says."""

    WITHIN = "within limits"
    OUT = "out of limits"
    TRENDING = "trending"
    TOO_FEW = "too few bags"


class Rule(str, Enum):
    """What a chart was found to break."""

    LIMIT = "beyond a control limit"
    ONE_SIDE = f"at least {ONE_SIDE} in a row on one side"
    MONOTONE = f"at least {MONOTONE} in a row in one direction"


@dataclass(frozen=True)
class Limits:
    """Control limits ``low``, ``high`` in the parameter's unit; ``source`` in words.

    ``middle_low`` to ``middle_high`` is where the parameter itself is thought to lie; a point where the bags' own mean
    is the centre. ``resolution`` is by how much a single bag may be off (95 %).
    """

    low: float
    middle_low: float
    middle_high: float
    high: float
    resolution: float
    source: str

    @property
    def centre(self) -> float:
        """The middle of the band."""
        return 0.5 * (self.middle_low + self.middle_high)

    @property
    def mirrored(self) -> Limits:
        """The limits of the values with the opposite sign."""
        return replace(
            self,
            low=-self.high,
            middle_low=-self.middle_high,
            middle_high=-self.middle_low,
            high=-self.low,
        )


@dataclass(frozen=True)
class Signal:
    """A ``rule`` that the bags from index ``first`` to ``last`` break, upwards (``direction`` 1) or downwards (−1)."""

    rule: Rule
    first: int
    last: int
    direction: int


@dataclass(frozen=True)
class Chart:
    """One parameter over the bags: ``value``, ``low``, ``high`` (bags,), NaN where a bag could not tell it.

    ``limits`` is None with too few bags; ``signals`` in the order of the bags where they begin.
    """

    key: str
    value: Array
    low: Array
    high: Array
    limits: Limits | None
    signals: tuple[Signal, ...]

    @property
    def state(self) -> State:
        """The verdict; what trends may be out of its limits as well."""
        rules = {signal.rule for signal in self.signals}
        if rules - {Rule.LIMIT}:
            return State.TRENDING
        if rules:
            return State.OUT
        return State.WITHIN if self.limits else State.TOO_FEW

    @property
    def began(self) -> int | None:
        """Index of the bag with which the move in the latest ``direction`` began; None without trouble.

        A drift drags the bags' mean along, so that bags from before it lie beyond the opposite limit: these are not
        where it began.
        """
        moved = [signal.first for signal in self.signals if signal.direction == self.direction]
        return min(moved, default=None)

    @property
    def direction(self) -> int:
        """Where it went last: 1 up, −1 down, 0 nowhere."""
        return max(self.signals, key=lambda signal: signal.last).direction if self.signals else 0

    @property
    def advice(self) -> str:
        """What a lab should look at; empty without trouble."""
        return ADVICE[self.key][self.direction] if self.signals else ""


def chart_of(key: str, estimates: Sequence[Estimate], known: ParameterFile) -> Chart:
    """The chart of a parameter of ``ADVICE`` from one estimate a bag, in the order of time.

    Limits are those of the parameter file where it has an interval for the key, else those of the bags themselves.
    """
    rows = [(e.value, e.low, e.high) if e.identifiable else (np.nan,) * 3 for e in estimates]
    value, low, high = np.array(rows, dtype=float).reshape(-1, 3).T
    resolution = _resolution(0.5 * (high - low))
    limits: Limits | None
    if key in known.intervals:
        limits = limits_of_file(known.intervals[key], resolution)
    else:
        limits = limits_of_bags(value, resolution)
    signals = () if limits is None else find_signals(value, limits)
    return Chart(key, value, low, high, limits, signals)


def _resolution(half: Array) -> float:
    """The median of what the bags' own 95 % intervals reach to each side; 0 if none has an end."""
    ends = half[np.isfinite(half)]
    return float(np.median(ends)) if ends.size else 0.0


def limits_of_file(interval: tuple[float, float], resolution: float) -> Limits:
    """Limits around a 95 % ``interval`` for bags whose own 95 % intervals reach ``resolution`` to each side.

    A single bag tells less than all those that the file was made of: the two variances add, and the limits lie
    three standard deviations of the sum from the middle of the file's interval.
    """
    centre, half = 0.5 * (interval[0] + interval[1]), 0.5 * (interval[1] - interval[0])
    reach = SIGMAS / quantile(np.inf) * float(np.hypot(half, resolution))
    source = "the parameter file: its 95 % interval and that of a bag, at three standard deviations"
    return Limits(centre - reach, interval[0], interval[1], centre + reach, resolution, source)


def limits_of_bags(value: Array, resolution: float) -> Limits | None:
    """X̄ ± 2.66·(mean moving range) of ``value`` (n,), NaN left out; None for fewer than five values.

    Ranges of few bags are small by chance at times: limits are never nearer than a bag's own 95 % ``resolution``.
    """
    known = value[np.isfinite(value)]
    if known.size < FEWEST_BAGS:
        return None
    centre = float(known.mean())
    ranges = INDIVIDUALS * float(np.abs(np.diff(known)).mean())
    source = f"these {known.size} bags: mean ± 2.66 mean moving ranges (Montgomery)"
    if ranges < resolution:
        source += ", widened to the 95 % interval of a bag"
    reach = max(ranges, resolution)
    return Limits(centre - reach, centre, centre, centre + reach, resolution, source)


def find_signals(value: Array, limits: Limits) -> tuple[Signal, ...]:
    """What ``value`` (n,) breaks; values that are NaN are skipped, as if their bags did not exist.

    A run rule counts only if the bags can tell such a move: from the first to the last bag of a monotone run, or
    from the middle to the mean of a run on one side.
    """
    index = np.flatnonzero(np.isfinite(value))
    known = value[index]
    signals = []
    for direction in (1, -1):
        broken = _broken(direction * known, limits if direction > 0 else limits.mirrored)
        signals += [Signal(rule, int(index[a]), int(index[b]), direction) for rule, a, b in broken]
    return tuple(sorted(signals, key=lambda signal: (signal.first, signal.last)))


def _broken(value: Array, limits: Limits) -> list[tuple[Rule, int, int]]:
    """(rule, first, last) of what is broken upwards."""
    monotone = [
        (Rule.MONOTONE, a, b + 1)
        for a, b in _stretches(np.diff(value) > 0.0, MONOTONE - 1)
        if value[b + 1] - value[a] > np.sqrt(2.0) * limits.resolution
    ]
    beyond = [(Rule.LIMIT, a, b) for a, b in _stretches(value > limits.high, 1)]
    above = value - limits.middle_high
    one_side = [
        (Rule.ONE_SIDE, a, b)
        for a, b in _stretches(above > 0.0, ONE_SIDE)
        if above[a : b + 1].mean() > limits.resolution / np.sqrt(b + 1 - a)
    ]
    return monotone + beyond + one_side


def _stretches(broken: NDArray[np.bool_], least: int) -> list[tuple[int, int]]:
    """(first, last) of the longest stretches of True that count at least so many."""
    edges = np.diff(np.concatenate([[0], broken.astype(int), [0]]))
    first, last = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1
    return [(int(a), int(b)) for a, b in zip(first, last, strict=True) if b - a + 1 >= least]


# By key and direction, what is the likely reason and what to do.
ADVICE: Mapping[str, Mapping[int, str]] = {
    "viscous_friction": {
        1: "the pipe is dirty or the fins are worn and rub: clean the pipe, look at the fins",
        -1: "the pipe is wet or greasy, or fins have lost touch: dry the pipe, look at the fins",
    },
    "switching_threshold": {
        1: "the fins bend further before they slip: look for stiffened, swapped or tilted fins",
        -1: "the fins slip sooner: look for worn fin tips or worn ridges, change the fins",
    },
    "gain": {
        1: "the spool winds more than before: look for cable wound in layers, check spool_radius_m",
        -1: "the cable is stretched or the spool slips: tighten the spool, change the cable",
    },
    "slack": {
        1: "the cable has become slack: re-tension it",
        -1: "the cable is tighter than before: look whether it was re-tensioned or has jammed",
    },
    "idle_power": {
        1: "something draws power at rest: look for a servo that holds a load, check the sensor's zero",
        -1: "less is drawn at rest: look for a device that is off, check the sensor's zero",
    },
}
