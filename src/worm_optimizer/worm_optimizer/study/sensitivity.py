# SPDX-License-Identifier: Apache-2.0
"""Sobol indices of speed, power and cliff over the uncertainty of the parameters.

The parameters vary independently. Each is normally distributed within its 95 % interval: that of the parameter file,
or the stated default (`robustness.uncertainty`). The indices divide the variance of a quantity between the parameters.
The first-order index of a parameter is the share that would vanish if this parameter alone were known. The total index
is the share that the parameter contributes to, alone or together with others. Samples (Saltelli) and estimators are
SciPy's.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import (
    asdict,
    dataclass,
    replace,
)
from typing import Any

import numpy as np
from scipy.stats import norm, sobol_indices

from worm_model.gait import Gait
from worm_model.parameters import ParameterFile
from worm_model.simulation.batch import evaluate_gaits
from worm_model.simulation.closed_form import cliff_margin, front_groove
from worm_optimizer.robustness.uncertainty import (
    LENGTH,
    MOTION_KEYS,
    POWER_KEYS,
    reach_of,
    values_at,
)
from worm_optimizer.search.task import Array

FIGURES = ("speed", "power", "cliff_margin")
_LEAST_VARIANCE = 1e-24  # a quantity with a variance below this does not vary


@dataclass(frozen=True)
class Indices:
    """Sobol indices of one quantity; NaN if the quantity does not vary.

    Attributes:
        first, total: first-order and total indices, shape (parameters,).
        first_bounds, total_bounds: 95 % bounds, shape (2, parameters).
        mean, deviation: mean and standard deviation of the quantity, in its unit.
    """

    first: Array
    total: Array
    first_bounds: Array
    total_bounds: Array
    mean: float
    deviation: float


@dataclass(frozen=True)
class Sensitivity:
    """Result of a sensitivity analysis.

    Attributes:
        gait: gait that was analysed.
        parameters: keys of the parameters that vary.
        reach: 95 % reach below and above the value of each parameter, in its unit.
        indices: indices by quantity.
        evaluations: number of simulated gaits.
    """

    gait: Gait
    parameters: tuple[str, ...]
    reach: Mapping[str, tuple[float, float]]
    indices: Mapping[str, Indices]
    evaluations: int


def sensitivity(gait: Gait, content: ParameterFile, samples: int, seed: int) -> Sensitivity:
    """Compute the indices of a gait's nominal speed (m/s) and power (W), and of the cliff margin (m, closed form).

    The number of simulated gaits is ``samples`` times the number of parameters plus three.

    Args:
        gait: gait; its margin is not used.
        content: parameters with their intervals.
        samples: number of samples, a power of two.
        seed: seed of the random numbers.
    """
    reach = _reach(content)

    def figures(deviates: Array) -> Array:
        return _figures(gait, content, reach, deviates)

    random = np.random.default_rng(seed)
    at_random = figures(random.standard_normal((len(reach), samples)))
    with np.errstate(invalid="ignore", divide="ignore"), warnings.catch_warnings():
        # The indices of a quantity that does not vary become NaN below.
        warnings.simplefilter("ignore")
        result = sobol_indices(
            func=figures, n=samples, dists=[norm()] * len(reach), random_state=random
        )
        bounds = _bootstrap(result, seed)
    indices = {}
    for k, name in enumerate(FIGURES):
        varies = float(np.var(at_random[k])) > _LEAST_VARIANCE
        unknown = 1.0 if varies else np.nan
        indices[name] = Indices(
            unknown * result.first_order[k],
            unknown * result.total_order[k],
            unknown * _interval(bounds.first_order, k),
            unknown * _interval(bounds.total_order, k),
            float(np.mean(at_random[k])),
            float(np.std(at_random[k])),
        )
    return Sensitivity(gait, tuple(reach), reach, indices, samples * (len(reach) + 3))


def _bootstrap(result: Any, seed: int) -> Any:
    """Return 95 % bounds of the indices.

    SciPy does not accept a generator here and draws from NumPy's global one, whose state is restored.
    """
    before = np.random.get_state()  # noqa: NPY002
    np.random.seed(seed)  # noqa: NPY002
    try:
        return result.bootstrap(confidence_level=0.95)
    finally:
        np.random.set_state(before)  # noqa: NPY002


def _interval(bounds: object, row: int) -> Array:
    interval = bounds.confidence_interval  # type: ignore[attr-defined]
    return np.stack([interval.low[row], interval.high[row]])


def _reach(content: ParameterFile) -> dict[str, tuple[float, float]]:
    """Return the reach of each uncertain parameter. The reach of L0 stands for that of the groove phase."""
    reaches = {key: reach_of(content, key) for key in (*MOTION_KEYS, *POWER_KEYS, LENGTH)}
    return {key: ends for key, ends in reaches.items() if max(ends) > 0.0}


def _figures(
    gait: Gait, content: ParameterFile, reach: Mapping[str, tuple[float, float]], deviates: Array
) -> Array:
    """Return the quantities, shape (figures, n), at standard normal deviates of shape (parameters, n)."""
    p = content.parameters
    drawn = values_at(p, reach, dict(zip(reach, deviates, strict=True)))
    longer = front_groove(p) * (drawn.get("pitch", np.full(deviates.shape[1], p.pitch)) - p.pitch)
    drawn[LENGTH] = (
        drawn.get(LENGTH, p.initial_length) + longer
    )  # the drawn value is the groove phase
    table = evaluate_gaits(**asdict(replace(gait, margin=0.0)), parameters=p, overrides=drawn)
    sets = (dict(zip(drawn, row, strict=True)) for row in np.stack(list(drawn.values()), axis=1))
    robots = (p.replace(**{k: float(v) for k, v in row.items()}) for row in sets)
    cliffs = [cliff_margin(robot, gait.direction) for robot in robots]
    return np.stack([table.speed, table.power, np.array(cliffs)])
