# SPDX-License-Identifier: Apache-2.0
"""Sobol indices of speed, power and cliff over the uncertainty of the parameters.

The draws of the parameters are independent and normally distributed. `robustness.uncertainty` defines their widths,
from the 95 % intervals of the parameter file or from defaults, and limits them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace

import numpy as np
from scipy.special import ndtri

from worm_model import parameters
from worm_model.gait import Gait
from worm_model.parameters import ParameterFile
from worm_model.simulation.batch import evaluate_gaits
from worm_model.simulation.closed_form import cliff_margin, front_groove
from worm_optimizer.evaluation.task import Array
from worm_optimizer.robustness.sobol import Indices, indices_of, saltelli_sample
from worm_optimizer.robustness.uncertainty import (
    LENGTH,
    MOTION_KEYS,
    POWER_KEYS,
    TRAVEL,
    reach_of,
    values_at,
)

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
