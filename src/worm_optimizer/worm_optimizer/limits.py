# SPDX-License-Identifier: Apache-2.0
"""Limits of the actuators and of the power sensor, as optional constraints on gaits."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from worm_model.gait import Gait
from worm_model.parameters import Parameters
from worm_model.simulator import simulate
from worm_optimizer.errors import OptimizerError

Array = NDArray[np.float64]
Peaks = Callable[[Gait, Parameters], tuple[float, float]]

_CYCLES = 3  # the third is periodic, up to the groove it is in
_SAMPLES = 400  # moments of that cycle at which force and power are looked at


@dataclass(frozen=True)
class ActuatorLimits:
    """Greatest values that a gait may ask of the hardware; infinite means no limit.

    ``cable_speed`` in m/s bounds the commanded cable speed, π·f·S at its fastest; ``cable_force`` in N
    bounds F_c (eq:Fc) and ``electrical_power`` in W the source power P (eq:power_model), such as the
    range of its sensor, both as the nominal model predicts them over a cycle.
    """

    cable_speed: float = math.inf
    cable_force: float = math.inf
    electrical_power: float = math.inf

    def __post_init__(self) -> None:
        for name, value in dataclasses.asdict(self).items():
            if not value > 0.0:
                raise OptimizerError(f"limits: {name} = {value}: give a positive number")

    @property
    def need_simulation(self) -> bool:
        """Whether a limit is set that only a simulated cycle can tell."""
        return math.isfinite(self.cable_force) or math.isfinite(self.electrical_power)

    def excess(self, speed: Array, force: Array, power: Array) -> Array:
        """Largest relative excess over the limits, 0 where all are kept; the arrays are peaks in m/s, N, W."""
        ratios = [
            speed / self.cable_speed,
            force / self.cable_force,
            power / self.electrical_power,
        ]
        return np.maximum(np.max(ratios, axis=0) - 1.0, 0.0)


def peaks(gait: Gait, parameters: Parameters) -> tuple[float, float]:
    """Greatest cable force in N and electrical power in W over a periodic cycle of a gait."""
    period = gait.period
    times = (_CYCLES - 1) * period + np.linspace(0.0, period, _SAMPLES, endpoint=False)
    sampled = simulate(gait, parameters, cycles=_CYCLES).at(times)
    return float(np.max(sampled.cable_force)), float(np.max(sampled.power))
