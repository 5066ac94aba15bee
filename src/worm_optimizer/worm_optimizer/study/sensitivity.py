# SPDX-License-Identifier: Apache-2.0
"""What decides speed, power and the cliff: Sobol indices over the parameters' uncertainty.

The parameters vary independently, each normally within its 95 % interval: that of the parameter file, else the stated
default (`robustness.uncertainty`, `report.expectation`). The variance of a figure is then shared out: the first-order
index of a parameter is the part of it that knowing this parameter alone would take away, the total index the part in
which it has a hand, together with others. Saltelli's samples and estimators are SciPy's.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.stats import norm, sobol_indices

from worm_model.gait import Gait
from worm_model.parameters import ParameterFile
from worm_model.simulation.batch import evaluate_gaits
from worm_model.simulation.closed_form import cliff_margin, front_groove, groove_phase
from worm_optimizer.report.expectation import NORMAL_95, POWER_HALF_WIDTHS
from worm_optimizer.robustness.uncertainty import half_widths, reach_of
from worm_optimizer.search.task import Array

FIGURES = ("speed", "power", "cliff_margin")
LENGTH = "initial_length"
_CUT = 4.0  # standard deviations at which a draw ends, so that it stays admissible
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
        found = sobol_indices(
            func=figures, n=samples, dists=[norm()] * len(reach), random_state=random
        )
        bounds = found.bootstrap(confidence_level=0.95)
    indices = {}
    for k, name in enumerate(FIGURES):
        varies = float(np.var(at_random[k])) > _LEAST_VARIANCE
        unknown = 1.0 if varies else np.nan
        indices[name] = Indices(
            unknown * found.first_order[k],
            unknown * found.total_order[k],
            unknown * _interval(bounds.first_order, k),
            unknown * _interval(bounds.total_order, k),
            float(np.mean(at_random[k])),
            float(np.std(at_random[k])),
        )
    return Sensitivity(gait, tuple(reach), reach, indices, samples * (len(reach) + 3))


def _interval(bounds: object, row: int) -> Array:
    interval = bounds.confidence_interval  # type: ignore[attr-defined]
    return np.stack([interval.low[row], interval.high[row]])


def _reach(content: ParameterFile) -> dict[str, tuple[float, float]]:
    """Of every parameter that is not exact; that of L0 stands for the groove phase."""
    power = {key: reach_of(content, key, width) for key, width in POWER_HALF_WIDTHS.items()}
    found = {**half_widths(content), **power, LENGTH: reach_of(content, LENGTH, 0.0)}
    return {key: ends for key, ends in found.items() if max(ends) > 0.0}


def _figures(
    gait: Gait, content: ParameterFile, reach: Mapping[str, tuple[float, float]], deviates: Array
) -> Array:
    """(figures, n) under standard normal deviates (parameters, n)."""
    p = content.parameters
    values = p.as_dict()
    offset = {
        key: np.where(row > 0.0, row * reach[key][1], row * reach[key][0])
        for key, row in zip(reach, np.clip(deviates, -_CUT, _CUT) / NORMAL_95, strict=True)
    }
    drawn = {key: np.maximum(values[key] + row, 0.1 * values[key]) for key, row in offset.items()}
    pitch = drawn.get("pitch", np.full(deviates.shape[1], p.pitch))
    drawn[LENGTH] = front_groove(p) * pitch + groove_phase(p) + offset.get(LENGTH, 0.0)
    least = 0.5001 * np.maximum(pitch, drawn.get("clearance", p.clearance))
    threshold = drawn.get("switching_threshold", p.switching_threshold)
    drawn["switching_threshold"] = np.maximum(threshold, least)
    table = evaluate_gaits(
        gait.stroke, gait.frequency, direction=gait.direction, parameters=p, overrides=drawn
    )
    sets = (dict(zip(drawn, row, strict=True)) for row in np.stack(list(drawn.values()), axis=1))
    cliffs = [cliff_margin(p.replace(**{k: float(v) for k, v in row.items()})) for row in sets]
    return np.stack([table.speed, table.power, np.array(cliffs)])
