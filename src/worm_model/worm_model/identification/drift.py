# SPDX-License-Identifier: Apache-2.0
"""Drift of parameters from bag to bag: control charts with one estimate per bag, in the order of time.

The charts are those for individual measurements with sensitizing rules in D. C. Montgomery, Introduction to
Statistical Quality Control (chapters on Shewhart charts and on individual measurements).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from worm_model.arrays import Array
from worm_model.identification.fits.estimate import Estimate, quantile
from worm_model.parameters import ParameterFile

FEWEST_BAGS = 5  # smallest number of bags for limits from moving ranges
# Smallest number of consecutive bags with rising values, or with falling values, that violates `Rule.MONOTONE`
MONOTONE = 6
SIGMAS = 3.0  # distance of a limit from the centre, in standard deviations
INDIVIDUALS = 2.66  # the same distance in mean moving ranges (see `limits_of_bags`): SIGMAS / 1.128


class State(StrEnum):
    """State of a chart."""

    WITHIN = "within limits"
    OUT = "out of limits"
    TRENDING = "trending"
    TOO_FEW = "too few bags"
    NOT_IDENTIFIABLE = "not identifiable"


class Rule(StrEnum):
    """Rule of a control chart."""

    LIMIT = "beyond a control limit"
    MONOTONE = f"at least {MONOTONE} in a row in one direction"


@dataclass(frozen=True)
class Limits:
    """Control limits in the parameter's unit.

    Attributes:
        low, centre, high: control limits, and the value between them.
        resolution: half-width of a single bag's 95 % interval, median over the bags.
        source: origin of the limits, as text.
    """

    low: float
    centre: float
    high: float
    resolution: float
    source: str


@dataclass(frozen=True)
class Signal:
    """Violation of a ``rule`` by consecutive bags.

    ``first`` and ``last`` are the indices of the first and the last of these bags. ``direction`` is 1 for values that
    are too high or rise, and −1 for values that are too low or fall.
    """

    rule: Rule
    first: int
    last: int
    direction: int


@dataclass(frozen=True)
class Chart:
    """Control chart of one parameter.

    Attributes:
        key: key of the parameter.
        value: estimates, shape (bags,); NaN where not identifiable.
        limits: control limits; None with too few bags.
        signals: violations, ordered by their first bag.
    """

    key: str
    value: Array
    limits: Limits | None
    signals: tuple[Signal, ...]

    @property
    def state(self) -> State:
        """State of the chart; a trending parameter may also be out of its limits."""
        rules = {signal.rule for signal in self.signals}
        if rules:
            return State.TRENDING if Rule.MONOTONE in rules else State.OUT
        if not np.isfinite(self.value).any():
            return State.NOT_IDENTIFIABLE
        return State.TOO_FEW if self.limits is None else State.WITHIN

    @property
    def began(self) -> int | None:
        """Index of the bag at which the latest drift began; None without a violation.

        A drift also moves the mean of the bags, so that earlier bags can violate the opposite limit. Only violations in
        the latest ``direction`` count, back to the first one before which a bag without a violation lies.
        """
        moved = [signal for signal in self.signals if signal.direction == self.direction]
        if not moved:
            return None
        began = max(moved, key=lambda signal: signal.last).first
        for signal in sorted(moved, key=lambda signal: -signal.last):
            if signal.last >= began - 1:
                began = min(began, signal.first)
        return began

    @property
    def direction(self) -> int:
        """Direction of the latest violation: 1 up, −1 down, 0 none."""
        return max(self.signals, key=lambda signal: signal.last).direction if self.signals else 0

    @property
    def advice(self) -> str:
        """Recommended inspection; empty without a violation."""
        return ADVICE[self.key][self.direction] if self.signals else ""


def chart_of(key: str, estimates: Sequence[Estimate], known: ParameterFile) -> Chart:
    """Return the chart of a parameter of ``ADVICE`` from one estimate per bag, in the order of time.

    The limits come from the parameter file if it has an interval for the key, else from the bags.
    """
    value = np.array([e.value if e.identifiable else np.nan for e in estimates])
    spreads = np.array([e.spread for e in estimates])
    known_spreads = spreads[np.isfinite(spreads)]
    resolution = float(np.median(known_spreads)) if known_spreads.size else 0.0
    if key in known.intervals:
        limits: Limits | None = limits_of_file(known.intervals[key], resolution)
    else:
        limits = limits_of_bags(value, resolution)
    return Chart(key, value, limits, () if limits is None else find_signals(value, limits))


def limits_of_file(interval: tuple[float, float], resolution: float) -> Limits:
    """Return limits from a 95 % ``interval`` of the parameter file and the bags' half-width ``resolution``.

    The centre is that of the file's interval. Each limit is three standard deviations from the centre. The variance is
    the sum of two variances: that of the file's estimate and that of the estimate from a single bag.
    """
    centre, half = 0.5 * (interval[0] + interval[1]), 0.5 * (interval[1] - interval[0])
    reach = SIGMAS / quantile(np.inf) * float(np.hypot(half, resolution))
    source = "the parameter file: its 95 % interval and the interval of a bag, at three standard deviations"
    return Limits(centre - reach, centre, centre + reach, resolution, source)


def limits_of_bags(value: Array, resolution: float) -> Limits | None:
    """Return limits from the finite values of ``value`` (n,); None for fewer than `FEWEST_BAGS` finite values.

    The limits are mean ± 2.66·(mean moving range). A moving range is the absolute difference between two successive
    values. Moving ranges of few bags can be small by chance. The limits are therefore at least one ``resolution`` (the
    half-width of a bag's 95 % interval) from the mean.
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
    return Limits(centre - reach, centre, centre + reach, resolution, source)


def find_signals(value: Array, limits: Limits) -> tuple[Signal, ...]:
    """Return the violations of ``value`` (n,); NaN values are skipped.

    A series of bags violates `Rule.MONOTONE` only if the difference between its last and its first value exceeds the
    uncertainty that follows from the resolution.
    """
    index = np.flatnonzero(np.isfinite(value))
    known = value[index]
    signals = []
    for direction, limit in ((1, limits.high), (-1, limits.low)):
        rows = [(Rule.LIMIT, a, b) for a, b in _stretches(direction * (known - limit) > 0.0, 1)]
        rising = direction * np.diff(known)
        rows += [
            (Rule.MONOTONE, a, b + 1)
            for a, b in _stretches(rising > 0.0, MONOTONE - 1)
            if rising[a : b + 1].sum() > np.sqrt(2.0) * limits.resolution
        ]
        signals += [Signal(rule, int(index[a]), int(index[b]), direction) for rule, a, b in rows]
    return tuple(sorted(signals, key=lambda signal: (signal.first, signal.last)))


def _stretches(broken: NDArray[np.bool_], least: int) -> list[tuple[int, int]]:
    """Return (first, last) of each uninterrupted sequence of True with at least ``least`` entries."""
    edges = np.diff(np.concatenate([[0], broken.astype(int), [0]]))
    first, last = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1
    return [(int(a), int(b)) for a, b in zip(first, last, strict=True) if b - a + 1 >= least]


MARGIN = "measured_margin"  # key of the smaller measured margin of both fins
# Likely cause and remedy by key and direction.
ADVICE: Mapping[str, Mapping[int, str]] = {
    "viscous_friction": {
        1: "the pipe is dirty or the fins are worn and rub: clean the pipe, inspect the fins",
        -1: "the pipe is wet or greasy, or fins touch no wall: dry the pipe, inspect the fins",
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
        -1: "the cable is tighter than before: check whether it was re-tensioned or has jammed",
    },
    "idle_power": {
        1: "something draws power at rest: look for a servo that holds a load, check the sensor's zero",
        -1: "the robot draws less power at rest: look for a device that is off, check the sensor's zero",
    },
    MARGIN: {
        1: "the gait has more to spare than before: check the length of the cable and the scale of the camera",
        -1: "the gait will lose grooves: inspect cable and fins, and tune the gait",
    },
}
