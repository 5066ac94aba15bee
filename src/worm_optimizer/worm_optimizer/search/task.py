# SPDX-License-Identifier: Apache-2.0
"""What is optimised: the box of gaits, the actuator limits and the evaluation of gaits in it.

Everything that searches (the exhaustive map, NSGA-II) sees a `Task`: bounds, and `points`, which
evaluates gaits. What "grooves gained" means is the task's: with an enlarged threshold (`MarginTask`),
or with a promised probability (`chance.PromiseTask`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from worm_model.gait import (
    FORWARD,
    FREQUENCY_RANGE,
    MAX_FREQUENCY,
    MAX_MARGIN,
    MAX_STROKE,
    REVERSE,
    STROKE_RANGE,
)
from worm_model.parameters import PAPER, Parameters
from worm_model.simulation.batch import GaitTable, evaluate_gaits
from worm_optimizer.search.actuator_limits import ActuatorLimits, peaks
from worm_optimizer.search.optimizer_errors import OptimizerError

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

# Decimals of a speed in m/s that tell gaits apart. Without it, at equal frequency, the remains of the
# transient and of rounding would let a longer stroke pass for faster and so for Pareto-optimal.
_SPEED_DECIMALS = 9
_TRANSIENT = 0.05  # pitches by which the advance of a cycle may fall short of the grooves gained


@dataclass(frozen=True)
class Bounds:
    """The box of gaits, p_min ≤ [S, f] ≤ p_max below eq:moo_formulation; strokes in m, frequencies in Hz.

    The defaults are the paper's. Raises `OptimizerError` unless 0 < low < high on both axes.
    """

    stroke_low: float = STROKE_RANGE[0]
    stroke_high: float = STROKE_RANGE[1]
    frequency_low: float = FREQUENCY_RANGE[0]
    frequency_high: float = FREQUENCY_RANGE[1]

    def __post_init__(self) -> None:
        _check_range("stroke", self.stroke_low, self.stroke_high, MAX_STROKE, "m")
        _check_range("frequency", self.frequency_low, self.frequency_high, MAX_FREQUENCY, "Hz")


def _check_range(name: str, low: float, high: float, most: float, unit: str) -> None:
    if not 0.0 < low < high <= most:
        raise OptimizerError(
            f"bounds: {name} from {low:g} to {high:g} {unit}: "
            f"both must be positive, rising and at most {most:g} {unit}"
        )


@dataclass(frozen=True)
class Points:
    """Evaluated gaits, one row each; every field is an array of shape (n,).

    ``speed`` counts along the gait's direction; ``branch`` is the least number of grooves gained in an
    averaged cycle and names the branch that the gait lies on;
    ``violation`` is 0 for a gait that gains a groove in every averaged cycle and keeps the actuator
    limits, and grows with what is missing.
    """

    stroke: Array  # m
    frequency: Array  # Hz
    speed: Array  # m/s
    power: Array  # W
    branch: Index  # 1
    violation: Array  # 1

    @property
    def admissible(self) -> Mask:
        """Which gaits violate nothing."""
        return self.violation <= 0.0

    def __len__(self) -> int:
        return len(self.stroke)

    def take(self, rows: ArrayLike) -> Points:
        """The rows at ``rows`` (integers or a mask)."""
        index = np.asarray(rows)
        return Points(*(getattr(self, row.name)[index] for row in dataclasses.fields(self)))

    @staticmethod
    def join(*parts: Points) -> Points:
        """The rows of all parts, in order."""
        names = [row.name for row in dataclasses.fields(Points)]
        return Points(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


def branch_of(table: GaitTable) -> Index:
    """Whole grooves gained in the poorest averaged cycle of each gait of a table, at least 0.

    The table tells the advance of the rear module in pitches, which misses a whole number by what is left
    of the transient. Gaits that the simulator gave up on (NaN) gain nothing.
    """
    advance = np.nan_to_num(table.min_grooves, nan=0.0)
    return np.floor(np.maximum(advance, 0.0) + _TRANSIENT).astype(np.int64)


class Task(Protocol):
    """What a search needs of an optimisation task."""

    @property
    def bounds(self) -> Bounds:
        """The box of gaits."""

    def points(self, stroke: ArrayLike, frequency: ArrayLike) -> Points:
        """Evaluates gaits; ``stroke`` in m and ``frequency`` in Hz of shape (n,)."""


@dataclass(frozen=True)
class MarginTask:
    """The problem of eq:moo_formulation with thresholds enlarged by ``margin`` m (eq:A1_switch_robust).

    Raises `OptimizerError` if the margin or the direction is not admissible.
    """

    parameters: Parameters = PAPER
    direction: int = FORWARD
    margin: float = 0.0
    bounds: Bounds = field(default_factory=Bounds)
    limits: ActuatorLimits = field(default_factory=ActuatorLimits)

    def __post_init__(self) -> None:
        if not 0.0 <= self.margin <= MAX_MARGIN:
            raise OptimizerError(f"margin: {self.margin} m is not between 0 and {MAX_MARGIN:g} m")
        if self.direction not in (FORWARD, REVERSE):
            raise OptimizerError(
                f"direction: {self.direction} is neither {FORWARD} (forward) nor {REVERSE} (reverse)"
            )

    def with_margin(self, margin: float) -> MarginTask:
        """The same task with another margin in m."""
        return dataclasses.replace(self, margin=margin)

    def table(
        self,
        stroke: ArrayLike,
        frequency: ArrayLike,
        margin: ArrayLike | None = None,
        overrides: Mapping[str, Array] | None = None,
    ) -> GaitTable:
        """The simulator's table of gaits inputs broadcast together.

        ``margin`` in m replaces the task's; ``overrides`` holds arrays of parameter values by key.
        """
        return evaluate_gaits(
            stroke,
            frequency,
            margin=self.margin if margin is None else margin,
            direction=self.direction,
            parameters=self.parameters,
            overrides=dict(overrides or {}),
        )

    def grooves(
        self,
        stroke: ArrayLike,
        frequency: ArrayLike,
        margin: ArrayLike | None = None,
        overrides: Mapping[str, Array] | None = None,
    ) -> Index:
        """Least grooves gained in an averaged cycle along the direction, at least 0; see `table`."""
        return branch_of(self.table(stroke, frequency, margin, overrides))

    def points(self, stroke: ArrayLike, frequency: ArrayLike) -> Points:
        """Evaluates gaits; ``stroke`` in m and ``frequency`` in Hz of shape (n,)."""
        strokes, frequencies = np.asarray(stroke, dtype=float), np.asarray(frequency, dtype=float)
        table = self.table(strokes, frequencies)
        branch = branch_of(table)
        return Points(
            strokes,
            frequencies,
            np.round(table.speed, _SPEED_DECIMALS),
            table.power,
            branch,
            np.where(branch >= 1, self._excess(strokes, frequencies, branch >= 1), 1.0),
        )

    def _excess(self, stroke: Array, frequency: Array, moving: Mask) -> Array:
        """Relative excess over the actuator limits; what needs a simulation only of the moving gaits.

        Of a gait that the simulator gives up on, all of it.
        """
        loads = np.zeros((3, stroke.size))
        if self.limits.need_simulation:
            peak = peaks(
                stroke[moving], frequency[moving], self.direction, self.parameters, self.limits
            )
            loads[:, moving] = peak.force, peak.power, peak.motor_load
        excess = self.limits.excess(np.pi * stroke * frequency, *loads)
        return np.nan_to_num(excess, nan=1.0)
