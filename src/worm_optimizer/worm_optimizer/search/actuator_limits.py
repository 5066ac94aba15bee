# SPDX-License-Identifier: Apache-2.0
"""Limits of the actuators and of the power sensor, as optional constraints on gaits."""

from __future__ import annotations

import dataclasses
import functools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from worm_model.gait import Gait
from worm_model.parameters import Parameters
from worm_model.simulation.simulator import simulate
from worm_optimizer.search.optimizer_errors import OptimizerError

Array = NDArray[np.float64]

_CYCLES = 3  # the third is periodic, up to the groove it is in
_SAMPLES = 400  # moments of that cycle at which force and power are looked at


@dataclass(frozen=True)
class ActuatorLimits:
    """Greatest values that a gait may ask of the hardware; infinite means no limit.

    ``cable_speed`` in m/s bounds the commanded cable speed, π·f·S at its fastest; ``cable_force`` in N
    bounds F_c (eq:Fc) and ``electrical_power`` in W the source power P (eq:power_model), such as the
    range of its sensor, both as the nominal model predicts them over a cycle. ``stall_force`` in N and
    ``no_load_speed`` in m/s are the ends of the motors' line of speed over torque: while the cable is
    pulled, F_c/stall_force + speed/no_load_speed stays below 1.
    """

    cable_speed: float = math.inf
    cable_force: float = math.inf
    electrical_power: float = math.inf
    stall_force: float = math.inf
    no_load_speed: float = math.inf

    def __post_init__(self) -> None:
        for name, value in dataclasses.asdict(self).items():
            if not value > 0.0:
                raise OptimizerError(f"limits: {name} = {value}: give a positive number")

    @property
    def need_simulation(self) -> bool:
        """Whether a limit is set that only a simulated cycle can tell."""
        simulated = self.cable_force, self.electrical_power, self.stall_force
        return any(math.isfinite(limit) for limit in simulated)

    def tightened(self, other: ActuatorLimits) -> ActuatorLimits:
        """The smaller of both limits each."""
        pairs = zip(dataclasses.astuple(self), dataclasses.astuple(other), strict=True)
        return ActuatorLimits(*(min(pair) for pair in pairs))

    def excess(self, speed: Array, force: Array, power: Array, motor_load: Array) -> Array:
        """Largest relative excess over the limits, 0 where all are kept; arrays as in `Peaks`."""
        ratios = [
            speed / self.cable_speed,
            force / self.cable_force,
            power / self.electrical_power,
            motor_load,
        ]
        return np.maximum(np.max(ratios, axis=0) - 1.0, 0.0)

    def description(self) -> str:
        """The limits that are set, in words; empty if there are none."""
        words = {
            "cable_speed": "cable speed {:.3g} m/s",
            "cable_force": "cable force {:.3g} N",
            "electrical_power": "power {:.3g} W",
            "stall_force": "stall at {:.3g} N",
            "no_load_speed": "no load at {:.3g} m/s",
        }
        values = dataclasses.asdict(self)
        return ", ".join(
            text.format(values[name]) for name, text in words.items() if math.isfinite(values[name])
        )


NO_LIMITS = ActuatorLimits()


@dataclass(frozen=True)
class Peaks:
    """Greatest cable force in N, electrical power in W and share (1) of the motors' line in a cycle."""

    force: float
    power: float
    motor_load: float


@functools.lru_cache(maxsize=2**15)  # the margins of a scan share the gaits of their grid
def peaks(gait: Gait, parameters: Parameters, limits: ActuatorLimits = NO_LIMITS) -> Peaks:
    """Peaks over a periodic cycle of a gait; ``limits`` hold the ends of the motors' line."""
    period = gait.period
    times = (_CYCLES - 1) * period + np.linspace(0.0, period, _SAMPLES, endpoint=False)
    sampled = simulate(gait, parameters, cycles=_CYCLES).at(times)
    turn = 2.0 * np.pi * gait.frequency
    pulled = np.maximum(0.5 * turn * gait.stroke * np.sin(turn * times), 0.0)
    load = np.maximum(sampled.cable_force, 0.0) / limits.stall_force + pulled / limits.no_load_speed
    return Peaks(
        force=float(np.max(sampled.cable_force)),
        power=float(np.max(sampled.power)),
        motor_load=float(np.max(np.where(pulled > 0.0, load, 0.0))),
    )
