# SPDX-License-Identifier: Apache-2.0
"""Saltelli samples, and Sobol indices of a result from one, with bootstrapped bounds.

The indices are shares of the variance of a result that depends on independent inputs. The first-order index of an
input is the share that vanishes on average when this input becomes known. The total index is the share that remains on
average when all other inputs are known. SciPy provides the estimators.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

#: Heads of the columns that `index_cells` returns.
INDEX_HEADS = ("alone", "95 % bounds", "with others", "95 % bounds")
#: Text in place of indices that are NaN, see `Indices`
NO_INDICES = "no indices: constant, or not finite at a point"
_CONSTANT = 1e-24  # largest variance, in squared units, of a quantity that counts as constant
_OUTSIDE = 5e-3  # distance below 0 or above 1 up to which an index is accepted as 0 or 1
_VISIBLE = 5e-4  # smallest difference of two indices that printed percentages show


def saltelli_sample(inputs: int, samples: int, seed: int) -> Array:
    """Return values between 0 and 1, shape (samples · (inputs + 2), inputs).

    Each base sample of a scrambled Sobol sequence has the rows A, B, AB_1 … AB_d. AB_k is A with element k replaced by
    element k of B.

    Args:
        inputs: number of inputs.
        samples: number of base samples, a power of two.
        seed: seed of the scrambling.
    """
    from scipy.stats import qmc  # here: the import takes a second

    unit = qmc.Sobol(2 * inputs, scramble=True, seed=seed).random(samples)
    first, second = unit[:, :inputs], unit[:, inputs:]
    mixed = np.repeat(first[:, None], inputs, axis=1)
    each = np.arange(inputs)
    mixed[:, each, each] = second
    rows = np.concatenate([first[:, None], second[:, None], mixed], axis=1)
    return rows.reshape(-1, inputs)


@dataclass(frozen=True)
class Indices:
    """Sobol indices of one result. They are NaN if the result is constant, or not finite at a point.

    Attributes:
        first, total: first-order and total indices, shape (inputs,).
        first_bounds, total_bounds: 95 % bounds, shape (2, inputs).
        mean, deviation: mean and standard deviation of the result, in its unit.
    """

    first: Array
    total: Array
    first_bounds: Array
    total_bounds: Array
    mean: float
    deviation: float

    @property
    def inconsistent(self) -> NDArray[np.intp]:
        """Inputs with indices that are impossible with enough samples.

        An index is below 0 or above 1, or the total index is below the first-order index.
        """
        least, most = np.minimum(self.first, self.total), np.maximum(self.first, self.total)
        outside = (least < -_OUTSIDE) | (most > 1.0 + _OUTSIDE)
        return np.flatnonzero(outside | (self.total < self.first - _VISIBLE))


def indices_of(values: Array, inputs: int, seed: int) -> Indices:
    """Return the indices of a result.

    Args:
        values: result at the points of a Saltelli sample, in the order of `saltelli_sample`, shape
            (samples · (inputs + 2),).
        inputs: number of inputs.
        seed: seed of the bootstrap.
    """
    from scipy.stats import sobol_indices  # here, because the import takes a second

    rows = values.reshape(-1, inputs + 2)
    plain = rows[:, :2]  # the points A and B of each base sample, which are independent
    mean, deviation = float(np.mean(plain)), float(np.std(plain))
    if not (np.all(np.isfinite(rows)) and deviation**2 > _CONSTANT):
        unknown = np.full(inputs, np.nan)
        pair = np.stack([unknown, unknown])
        return Indices(unknown, unknown, pair, pair, mean, deviation)
    twice = np.stack([rows, rows])  # SciPy fails for one result of one input
    with np.errstate(invalid="ignore", divide="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # SciPy warns about bootstrap draws without variance
        result = sobol_indices(
            func={
                "f_A": twice[:, :, 0],
                "f_B": twice[:, :, 1],
                "f_AB": np.moveaxis(twice[:, :, 2:], 2, 0),
            },
            n=len(rows),
        )
        bounds = _bootstrap(result, seed)

    def first_row(values: Array) -> Array:
        return np.reshape(values, (2, inputs))[0]

    def interval(bound: Any) -> Array:
        ends = bound.confidence_interval
        return np.stack([first_row(ends.low), first_row(ends.high)])

    return Indices(
        first_row(result.first_order),
        first_row(result.total_order),
        interval(bounds.first_order),
        interval(bounds.total_order),
        mean,
        deviation,
    )


def _bootstrap(result: Any, seed: int) -> Any:
    """Return 95 % bounds of the indices.

    SciPy's bootstrap draws from NumPy's global generator. Its state is restored afterwards.
    """
    before = np.random.get_state()  # noqa: NPY002
    np.random.seed(seed)  # noqa: NPY002
    try:
        return result.bootstrap(confidence_level=0.95)
    finally:
        np.random.set_state(before)  # noqa: NPY002


def index_json(indices: Indices, inputs: Sequence[str]) -> dict[str, Any]:
    """Return the indices of each input with their bounds, for JSON."""
    return {
        key: {
            "first": indices.first[k],
            "first_bounds": indices.first_bounds[:, k],
            "total": indices.total[k],
            "total_bounds": indices.total_bounds[:, k],
        }
        for k, key in enumerate(inputs)
    }


def percent(value: float) -> str:
    """Return a share as a percentage, never as "-0.0 %". Of an impossible share, return the bound that it exceeds."""
    rounded = round(100.0 * value, 1)
    if rounded < 0.0:
        return "< 0 %"
    return "> 100 %" if rounded > 100.0 else f"{rounded + 0.0:.1f} %"


def index_cells(indices: Indices, row: int) -> list[str]:
    """Return the first-order index of an input, its bounds, its total index and the bounds of that as text."""
    first, total = indices.first[row], indices.total[row]
    bounds = indices.first_bounds[:, row], indices.total_bounds[:, row]
    texts = [" to ".join(map(percent, ends)) for ends in bounds]
    return [percent(first), texts[0], percent(total), texts[1]]


def warnings_of(name: str, indices: Indices, inputs: Sequence[str]) -> list[str]:
    """Return the reasons to distrust the indices of a result."""
    if not indices.inconsistent.size:
        return []
    listed = ", ".join(inputs[k] for k in indices.inconsistent)
    return [
        f"{name}: indices of {listed} are below 0 %, above 100 % or in the wrong order: use more samples"
    ]
