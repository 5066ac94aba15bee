# SPDX-License-Identifier: Apache-2.0
"""What decides speed, power and the cliff: Sobol indices over the parameters' uncertainty.

The parameters vary independently, each normally within its 95 % interval: that of the parameter file, else the stated
default (`robustness.uncertainty`). The variance of a figure is then shared out: the first-order
index of a parameter is the part of it that knowing this parameter alone would take away, the total index the part in
which it has a hand, together with others. Saltelli's samples and estimators are SciPy's.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import norm, sobol_indices

from worm_model.gait import Gait
from worm_model.parameters import ParameterFile
from worm_model.simulation.batch import evaluate_gaits
from worm_model.simulation.closed_form import cliff_margin, front_groove
from worm_optimizer.robustness.uncertainty import (
    MOTION_HALF_WIDTHS,
    POWER_HALF_WIDTHS,
    reach_of,
    values_at,
)
from worm_optimizer.search.task import Array

FIGURES = ("speed", "power", "cliff_margin")
LENGTH = "initial_length"
_LEAST_VARIANCE = 1e-24  # of a figure, below which it does not vary


@dataclass(frozen=True)
class Indices:
    """Of one figure: ``first`` and ``total`` (parameters,), with 95 % bounds (2, parameters); NaN if it never varies.

    ``mean`` and standard ``deviation`` of the figure in its unit.
    """

    first: Array
    total: Array
    first_bounds: Array
    total_bounds: Array
    mean: float
    deviation: float


@dataclass(frozen=True)
class Sensitivity:
    """``parameters``: the keys that vary, with their ``reach`` (95 %, below and above the value); indices by figure."""

    gait: Gait
    parameters: tuple[str, ...]
    reach: Mapping[str, tuple[float, float]]
    indices: Mapping[str, Indices]
    evaluations: int


def sensitivity(gait: Gait, content: ParameterFile, samples: int, seed: int) -> Sensitivity:
    """Indices of a gait's nominal speed (m/s) and power (W) and of the cliff's margin (m, closed form).

    ``samples``, a power of two, times the number of parameters and two gaits are simulated.
    """
    reach = _reach(content)

    def figures(deviates: Array) -> Array:
        return _figures(gait, content, reach, deviates)

    random = np.random.default_rng(seed)
    at_random = figures(random.standard_normal((len(reach), samples)))
    with np.errstate(invalid="ignore", divide="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a figure that does not vary has no indices, as is told
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
    """95 % bounds of indices; SciPy takes no generator for them and draws from NumPy's global one."""
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
    """Of every parameter that is not exact; that of L0 stands for the groove phase."""
    reaches = {
        key: reach_of(content, key) for key in (*MOTION_HALF_WIDTHS, *POWER_HALF_WIDTHS, LENGTH)
    }
    return {key: ends for key, ends in reaches.items() if max(ends) > 0.0}


def _figures(
    gait: Gait, content: ParameterFile, reach: Mapping[str, tuple[float, float]], deviates: Array
) -> Array:
    """(figures, n) under standard normal deviates (parameters, n)."""
    p = content.parameters
    drawn = values_at(p, reach, dict(zip(reach, deviates, strict=True)))
    longer = front_groove(p) * (drawn.get("pitch", np.full(deviates.shape[1], p.pitch)) - p.pitch)
    drawn[LENGTH] = (
        drawn.get(LENGTH, p.initial_length) + longer
    )  # the groove phase is what was drawn
    table = evaluate_gaits(
        gait.stroke, gait.frequency, direction=gait.direction, parameters=p, overrides=drawn
    )
    sets = (dict(zip(drawn, row, strict=True)) for row in np.stack(list(drawn.values()), axis=1))
    cliffs = [cliff_margin(p.replace(**{k: float(v) for k, v in row.items()})) for row in sets]
    return np.stack([table.speed, table.power, np.array(cliffs)])
