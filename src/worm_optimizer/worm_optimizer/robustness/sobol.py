# SPDX-License-Identifier: Apache-2.0
"""Samples of several quantities, and Sobol indices of a result from a Saltelli sample, with bootstrapped bounds.

The indices are shares of the variance of a result that depends on independent inputs. The first-order index of an
input is the share that vanishes on average when this input becomes known. The total index is the share that remains on
average when all other inputs are known. SciPy provides the estimators.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from worm_msgs.settings_file import OneOf, key

Array = NDArray[np.float64]

SOBOL, SALTELLI, LATIN_HYPERCUBE = "sobol", "saltelli", "latin_hypercube"
METHODS = (SOBOL, SALTELLI, LATIN_HYPERCUBE)
MOST_POINTS = 1_000_000  # of a study, whose results are in memory at the end
#: Heads of the columns that `index_cells` returns.
INDEX_HEADS = ("alone", "95 % bounds", "with others", "95 % bounds")
#: Text in place of indices that are NaN, see `Indices`
NO_INDICES = "no indices: constant, or not finite at a point"
_CONSTANT = 1e-24  # largest variance, in squared units, of a quantity that counts as constant
_OUTSIDE = 5e-3  # distance below 0 or above 1 up to which an index is accepted as 0 or 1
_VISIBLE = 5e-4  # smallest difference of two indices that printed percentages show


@dataclass(frozen=True)
class Sample:
    """Sampling of all axes with a range: ``method`` (one of `METHODS`), number of ``points`` and ``seed``.

    With `SALTELLI`, ``points`` is the number of base samples, each of which results in d + 2 points for d axes.
    """

    method: Annotated[str, OneOf(METHODS)] = SOBOL
    points: Annotated[int, key(ge=1, le=MOST_POINTS)] = 64
    seed: Annotated[int, key(ge=0, lt=2**32)] = 1

    def size(self, axes: int) -> int:
        """Return the number of points for ``axes`` axes with a range."""
        return self.points * (axes + 2 if self.method == SALTELLI else 1)

    def draw(self, axes: int) -> Array:
        """Return values between 0 and 1, shape (size, axes).

        Sobol sequences are scrambled, because an unscrambled one begins with a point whose values are all exactly 0.
        With `SOBOL` and `SALTELLI`, a larger sample begins with the points of a smaller one.
        """
        from scipy.stats import qmc  # here: the import takes a second, and workers do not need it

        if self.method == LATIN_HYPERCUBE:
            return qmc.LatinHypercube(axes, seed=self.seed).random(self.points)
        saltelli = self.method == SALTELLI
        engine: Any = qmc.Sobol(2 * axes if saltelli else axes, scramble=True, seed=self.seed)
        unit = engine.random_base2(math.ceil(math.log2(max(self.points, 2))))[: self.points]
        return _saltelli(unit[:, :axes], unit[:, axes:]) if saltelli else unit


def _saltelli(first: Array, second: Array) -> Array:
    """Return the rows A, B, AB_1 … AB_d of each base sample, one base sample after another.

    A is the row of the base sample in ``first``, and B its row in ``second``. AB_k is A with element k replaced by
    element k of B.
    """
    mixed = np.repeat(first[:, None], first.shape[1], axis=1)
    each = np.arange(first.shape[1])
    mixed[:, each, each] = second
    rows = np.concatenate([first[:, None], second[:, None], mixed], axis=1)
    return rows.reshape(-1, first.shape[1])


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
        values: result at the points of a Saltelli sample, in the order of `Sample.draw`, shape
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
