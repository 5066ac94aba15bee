# SPDX-License-Identifier: Apache-2.0
"""Runs of equal values of a step function of the stroke. A scan finds the steps, and bisection locates them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from worm_model.arrays import Array

Index = NDArray[np.int64]

# Returns the labels (values of the step function), shape (n,). Arguments: strokes in m, and indices of their columns,
# (n,) each. Each column has its own step function, for example because each column has another frequency.
Label = Callable[[Array, Index], Index]

_PARTS = 8  # number of parts into which an interval with a step is divided first, to find narrow runs next to the step


@dataclass(frozen=True)
class Runs:
    """Maximal intervals of the stroke with one label, by column and rising stroke; every field has shape (n,).

    Attributes:
        column: index of the column.
        label: label of all strokes of the run.
        low, high: shortest and longest evaluated stroke of the run, m.
        stepped: True if a stroke with another label precedes ``low`` by at most the tolerance. False if ``low`` is the
            first stroke of the scan.
    """

    column: Index
    label: Index
    low: Array
    high: Array
    stepped: NDArray[np.bool_]


def find_runs(label: Label, strokes: Array, tolerance: float) -> Runs:
    """Find the runs of all columns at once.

    The scan evaluates ``strokes`` in m, shape (columns, scan), which do not decrease along each row. Each interval
    between neighbours with different labels is then divided into `_PARTS` parts, and halved until it is at most
    ``tolerance`` m wide. A run that lies between two strokes of the scan with equal labels is not found.
    """
    columns, scan = strokes.shape
    column = np.repeat(np.arange(columns), scan)
    stroke = strokes.ravel()
    values = label(stroke, column)
    parts = _PARTS
    while True:
        step = (column[1:] == column[:-1]) & (values[1:] != values[:-1])
        gap = stroke[1:] - stroke[:-1]
        open_ = np.flatnonzero(step & (gap > tolerance))
        if not open_.size:
            break
        shares = np.arange(1, parts) / parts
        between = (stroke[open_][:, np.newaxis] + gap[open_][:, np.newaxis] * shares).ravel()
        of_column = np.repeat(column[open_], parts - 1)
        place = np.repeat(open_ + 1, parts - 1)
        values = np.insert(values, place, label(between, of_column))
        stroke, column = np.insert(stroke, place, between), np.insert(column, place, of_column)
        parts = 2
    if not stroke.size:
        return Runs(column, values, stroke, stroke, np.empty(0, dtype=bool))
    first = np.flatnonzero(np.r_[True, (column[1:] != column[:-1]) | (values[1:] != values[:-1])])
    last = np.r_[first[1:], column.size] - 1
    new_column = np.r_[True, column[first][1:] != column[first][:-1]]
    return Runs(column[first], values[first], stroke[first], stroke[last], ~new_column)
