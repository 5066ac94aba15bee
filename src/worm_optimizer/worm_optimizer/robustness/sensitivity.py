# SPDX-License-Identifier: Apache-2.0
"""Sobol indices of speed, power and cliff over the uncertainty of the parameters.

The draws of the parameters are independent and normally distributed. `robustness.uncertainty` defines their widths,
from the 95 % intervals of the parameter file or from defaults, and limits them.

The indices are shares of the variance of a result that depends on independent inputs. The first-order index of an
input is the share that vanishes on average when this input becomes known. The total index is the share that remains on
average when all other inputs are known. SciPy provides the estimators.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from worm_model import parameters
from worm_model.gait import Gait
from worm_model.parameters import ParameterFile
from worm_model.simulation.batch import evaluate_gaits
from worm_model.simulation.closed_form import cliff_margin, front_groove
from worm_optimizer.evaluation.task import Array
from worm_optimizer.robustness.uncertainty import (
    LENGTH,
    MOTION_KEYS,
    POWER_KEYS,
    TRAVEL,
    reach_of,
    values_at,
)

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


FIGURES = ("speed", "power", "cliff_margin")  # quantities whose indices are computed
#: symbols and units of all inputs
SYMBOLS = {**parameters.SYMBOLS, TRAVEL: "e"}
UNITS = {**parameters.UNITS, TRAVEL: "m"}


@dataclass(frozen=True)
class Sensitivity:
    """Result of a sensitivity analysis.

    Attributes:
        gait: gait that was analysed.
        parameters: keys of the parameters that vary.
        reach: distances from the value of each parameter down and up to its 95 % bounds, in its unit.
        indices: Sobol indices by name of `FIGURES`.
        evaluations: number of simulated gaits.
    """

    gait: Gait
    parameters: tuple[str, ...]
    reach: Mapping[str, tuple[float, float]]
    indices: Mapping[str, Indices]
    evaluations: int


def sensitivity(gait: Gait, content: ParameterFile, samples: int, seed: int) -> Sensitivity:
    """Compute the indices of a gait's nominal speed (m/s) and power (W), and of the cliff margin (m, closed form).

    The number of simulated gaits is samples · (parameters + 2).

    Args:
        gait: gait; its margin is ignored.
        content: parameters with their intervals.
        samples: number of base samples, a power of two.
        seed: seed of the random numbers.
    """
    reach = _reach(content)
    deviates = ndtri(saltelli_sample(len(reach), samples, seed)).T
    columns = _figures(gait, content, reach, deviates)
    indices = {
        name: indices_of(values, len(reach), seed)
        for name, values in zip(FIGURES, columns, strict=True)
    }
    return Sensitivity(gait, tuple(reach), reach, indices, deviates.shape[1])


def _reach(content: ParameterFile) -> dict[str, tuple[float, float]]:
    """Return the reach of each uncertain parameter. The reach of L0 is used for the groove phase, see `_figures`."""
    reaches = {key: reach_of(content, key) for key in (*MOTION_KEYS, *POWER_KEYS, LENGTH)}
    return {key: ends for key, ends in reaches.items() if max(ends) > 0.0}


def _figures(
    gait: Gait, content: ParameterFile, reach: Mapping[str, tuple[float, float]], deviates: Array
) -> Array:
    """Return the quantities of `FIGURES`, shape (3, n), at standard normal deviates of shape (parameters, n).

    The body length that is used is the drawn L0 plus n0 times the deviation of the drawn pitch. The groove phase
    therefore depends only on the draw of L0.
    """
    p = content.parameters
    drawn = values_at(content, reach, dict(zip(reach, deviates, strict=True)))
    longer = front_groove(p) * (drawn.get("pitch", np.full(deviates.shape[1], p.pitch)) - p.pitch)
    drawn[LENGTH] = drawn.get(LENGTH, p.initial_length) + longer
    table = evaluate_gaits(**asdict(replace(gait, margin=0.0)), parameters=p, overrides=drawn)
    sets = (dict(zip(drawn, row, strict=True)) for row in np.stack(list(drawn.values()), axis=1))
    robots = (p.replace(**{k: float(v) for k, v in row.items()}) for row in sets)
    cliffs = [cliff_margin(robot, gait.direction, gait.pretension) for robot in robots]
    return np.stack([table.speed, table.power, np.array(cliffs)])
