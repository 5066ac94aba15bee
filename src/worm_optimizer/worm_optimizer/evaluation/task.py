# SPDX-License-Identifier: Apache-2.0
"""Optimisation tasks: the box of gaits, the actuator limits, and the batch evaluation of gaits and of branch edges.

Every search (the exact front, NSGA-II) uses a `Task`. The task defines how many grooves a gait gains: those gained with
an enlarged threshold (`MarginTask`), or those gained with a required probability (`chance.PromiseTask`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from worm_model.errors import InputError
from worm_model.gait import AVERAGED, FREQUENCY_RANGE, STROKE_RANGE
from worm_model.parameters import PAPER, Parameters
from worm_msgs.gait import FORWARD, MAX_FREQUENCY, MAX_MARGIN, MAX_STROKE, REVERSE
from worm_optimizer.evaluation.actuator_limits import NO_LIMITS, ActuatorLimits, Peaks, peaks
from worm_optimizer.evaluation.command_shape import SINUSOID, Shapes, fields_of, peak_rates
from worm_optimizer.evaluation.runs import Array, Index, find_runs

if TYPE_CHECKING:  # Numba loads slowly
    from worm_model.simulation.batch import GaitTable

Mask = NDArray[np.bool_]

EDGE_TOLERANCE = 1e-8  # width of the bracket to which the edge of a branch is bisected, m
# Length that is added to the stroke at the edge, m. With the exact stroke, rounding on another processor could lose a
# groove. The addition costs less than a millionth of the power.
EDGE_ALLOWANCE = 1e-8


@dataclass(frozen=True)
class Bounds:
    """Box of gaits, with strokes in m and frequencies in Hz.

    In the paper, the box is p_min ≤ [S, f] ≤ p_max in the text after eq:moo_formulation. The defaults are the paper's.
    A quantity with equal bounds is fixed. Raises `InputError` unless 0 < low ≤ high ≤ the maximum of a
    gait, for strokes and frequencies.
    """

    stroke_low: float = STROKE_RANGE[0]
    stroke_high: float = STROKE_RANGE[1]
    frequency_low: float = FREQUENCY_RANGE[0]
    frequency_high: float = FREQUENCY_RANGE[1]

    def __post_init__(self) -> None:
        _check_range("stroke", self.stroke_low, self.stroke_high, MAX_STROKE, "m")
        _check_range("frequency", self.frequency_low, self.frequency_high, MAX_FREQUENCY, "Hz")


def _check_range(name: str, low: float, high: float, most: float, unit: str) -> None:
    if not 0.0 < low <= high <= most:
        raise InputError(
            f"bounds: {name} from {low:g} to {high:g} {unit}: "
            f"give positive values, the lower first, of at most {most:g} {unit}"
        )


@dataclass(frozen=True)
class Points:
    """Evaluated gaits, one row for each; every field has shape (n,).

    ``speed`` is along the gait's direction. ``count`` identifies the branch: the grooves gained in all averaged cycles
    together, or 0 if one of these cycles gains none. ``violation`` is the largest ratio of a quantity to its actuator
    limit, minus 1. It is 1 for a gait with count 0, and at most 0 for a moving gait that satisfies all limits. The
    default ``shape`` is the paper's sinusoid.
    """

    stroke: Array  # m
    frequency: Array  # Hz
    speed: Array  # m/s
    power: Array  # W
    count: Index  # 1
    violation: Array  # 1
    shape: Shapes = field(default_factory=lambda: SINUSOID)

    def __post_init__(self) -> None:
        object.__setattr__(self, "shape", np.broadcast_to(self.shape, self.stroke.shape))

    @property
    def grooves(self) -> Array:
        """Mean grooves per averaged cycle; a fraction where the averaged cycles differ."""
        return self.count / AVERAGED

    @property
    def admissible(self) -> Mask:
        """True for gaits that move and satisfy all limits."""
        return self.violation <= 0.0

    def __len__(self) -> int:
        return len(self.stroke)

    def take(self, rows: ArrayLike) -> Points:
        """Return the given rows (integers or a mask)."""
        index = np.asarray(rows)
        return Points(*(getattr(self, row.name)[index] for row in dataclasses.fields(self)))

    @staticmethod
    def join(*parts: Points) -> Points:
        """Return the rows of all parts, in order."""
        names = [row.name for row in dataclasses.fields(Points)]
        return Points(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


def gained_of(table: GaitTable) -> Index:
    """Return the grooves gained in all averaged cycles together, or 0 if one of these cycles gains none."""
    from worm_model.simulation.batch import branch_of

    gained = np.where(branch_of(table) >= 1, AVERAGED * table.grooves_per_cycle, 0.0)
    return np.rint(gained).astype(np.int64)


@dataclass(frozen=True)
class Edges:
    """Lower edges of branches: ``points``, and the index of the ``column`` (frequency) of each of them, shape (n,)."""

    column: Index
    points: Points


class Task(Protocol):
    """Batch evaluation of gaits and of branch edges, as a search needs it."""

    @property
    def bounds(self) -> Bounds:
        """Box of gaits."""

    def points(self, stroke: ArrayLike, frequency: ArrayLike, shape: Shapes = SINUSOID) -> Points:
        """Return the evaluated gaits. ``stroke`` in m, ``frequency`` in Hz and ``shape`` have shape (n,)."""

    def edges(self, frequency: Array, strokes: Array, count: Index | None = None) -> Edges:
        """Find the shortest admissible stroke of each branch at each frequency, here called a column.

        Args:
            frequency: frequency of each column in Hz, shape (m,).
            strokes: rising strokes of each column in m, shape (m, scan). They span the range that is searched.
            count: count (see `Points`) of the edge that is needed in each column, shape (m,). None finds all edges.
        """


@dataclass(frozen=True)
class MarginTask:
    """Task of eq:moo_formulation with thresholds enlarged by ``margin`` in m (eq:A1_switch_robust).

    ``bounds.stroke_high`` limits the largest contraction, including the pretension.

    Raises `InputError` if the margin, the direction, a stroke of the box or a limit is inadmissible.
    """

    parameters: Parameters = PAPER
    direction: int = FORWARD
    margin: float = 0.0
    bounds: Bounds = field(default_factory=Bounds)
    limits: ActuatorLimits = field(default_factory=ActuatorLimits)

    def __post_init__(self) -> None:
        if not 0.0 <= self.margin <= MAX_MARGIN:
            raise InputError(f"margin: {self.margin} m is not between 0 and {MAX_MARGIN:g} m")
        if self.direction not in (FORWARD, REVERSE):
            raise InputError(
                f"direction: {self.direction} is neither {FORWARD} (forward) nor {REVERSE} (reverse)"
            )
        length, idle = self.parameters.initial_length, self.parameters.idle_power
        if self.bounds.stroke_high >= length:
            raise InputError(
                f"bounds: stroke up to {self.bounds.stroke_high:g} m; the body is {length:g} m long. "
                f"Use strokes below {length:g} m"
            )
        if self.limits.electrical_power <= idle:
            raise InputError(
                f"limits: electrical_power = {self.limits.electrical_power:g} W is at most the idle power of "
                f"{idle:g} W, so that no gait satisfies this limit: raise it"
            )

    def with_margin(self, margin: float) -> MarginTask:
        """Return the same task with another margin in m."""
        return dataclasses.replace(self, margin=margin)

    def table(
        self,
        stroke: ArrayLike,
        frequency: ArrayLike,
        margin: ArrayLike | None = None,
        overrides: Mapping[str, Array] | None = None,
        shape: Shapes = SINUSOID,
    ) -> GaitTable:
        """Return the simulator's table of gaits. All arguments are broadcast together.

        ``margin`` in m replaces that of the task. ``overrides`` contains arrays of parameter values by key.
        """
        from worm_model.simulation.batch import evaluate_gaits

        return evaluate_gaits(
            stroke,
            frequency,
            margin=self.margin if margin is None else margin,
            direction=self.direction,
            parameters=self.parameters,
            overrides=dict(overrides or {}),
            **fields_of(shape),
        )

    def grooves(
        self,
        stroke: ArrayLike,
        frequency: ArrayLike,
        margin: ArrayLike | None = None,
        overrides: Mapping[str, Array] | None = None,
        shape: Shapes = SINUSOID,
    ) -> Index:
        """Return the grooves gained along the direction in the worst averaged cycle, at least 0; see `table`."""
        from worm_model.simulation.batch import branch_of

        return branch_of(self.table(stroke, frequency, margin, overrides, shape))

    def points(
        self,
        stroke: ArrayLike,
        frequency: ArrayLike,
        shape: Shapes = SINUSOID,
        margin: ArrayLike | None = None,
    ) -> Points:
        """Return the evaluated gaits, see `Task`. ``margin`` in m replaces that of the task."""
        strokes, frequencies = np.asarray(stroke, dtype=float), np.asarray(frequency, dtype=float)
        shapes = np.broadcast_to(shape, strokes.shape)
        table = self.table(strokes, frequencies, margin, shape=shapes)
        count = gained_of(table)
        moving = count > 0
        violation = np.ones(strokes.shape)
        violation[moving] = self.excess(strokes[moving], frequencies[moving], shapes[moving])
        return Points(strokes, frequencies, table.speed, table.power, count, violation, shapes)

    def edges(
        self,
        frequency: Array,
        strokes: Array,
        count: Index | None = None,
        margin: Array | None = None,
    ) -> Edges:
        """Find the lower edges of all branches by scan and bisection, see `Task`.

        ``margin`` contains the margin of each column in m, shape (m,). None uses the margin of the task.
        """
        margins = np.full(frequency.shape, self.margin) if margin is None else margin
        within = np.clip(strokes, self.bounds.stroke_low, self.bounds.stroke_high)

        def points(stroke: Array, column: Index) -> Points:
            return self.points(stroke, frequency[column], margin=margins[column])

        def label(stroke: Array, column: Index) -> Index:
            # The label is even within the actuator limits and odd beyond them, so that limits are located like edges.
            found = points(stroke, column)
            return np.where(found.count > 0, 2 * found.count + ~found.admissible, 0)

        runs = find_runs(label, within, EDGE_TOLERANCE)
        allowance = np.where(runs.stepped, EDGE_ALLOWANCE, 0.0)
        safe = np.minimum(runs.low + allowance, self.bounds.stroke_high)
        found = points(safe, runs.column)
        is_edge = found.admissible & (2 * found.count == runs.label)
        if count is not None:
            is_edge &= found.count == count[runs.column]
        return Edges(runs.column[is_edge], found.take(is_edge))

    def excess(self, stroke: Array, frequency: Array, shape: Shapes) -> Array:
        """Return the relative excess of moving gaits over the limits; 1 for gaits that cannot be simulated."""
        if self.limits == NO_LIMITS:
            return np.full(stroke.shape, -1.0)
        peak = Peaks.none(stroke.size)
        if self.limits.need_simulation:
            peak = peaks(stroke, frequency, self.direction, self.parameters, self.limits, shape)
        excess = self.limits.excess(peak_rates(shape) * stroke * frequency, peak)
        return np.nan_to_num(excess, nan=1.0)
