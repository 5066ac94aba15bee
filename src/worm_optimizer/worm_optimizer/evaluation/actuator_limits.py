# SPDX-License-Identifier: Apache-2.0
"""Limits of the actuators and of the power sensor, as optional constraints on gaits."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from worm_model.parameters import Parameters
from worm_model.simulation.batch import sample_cycle
from worm_optimizer.evaluation.command_shape import (
    SINUSOID,
    Shapes,
    fields_of,
    peak_rate,
    pull_rate,
    sample_phases,
)
from worm_optimizer.optimizer_errors import OptimizerError

Array = NDArray[np.float64]

_CYCLE = 2  # number of the sampled cycle, from 0: the third one is periodic, except for the groove
_SAMPLES = 400  # moments of that cycle at which force and power are sampled


@dataclass(frozen=True)
class ActuatorLimits:
    """Largest values that a gait may require of the hardware; infinity means no limit.

    ``cable_speed`` in m/s bounds the largest commanded cable speed, π·f·S of the sinusoid; ``cable_force`` in N
    bounds F_c (eq:Fc) and ``electrical_power`` in W the source power P (eq:power_model), such as the range of its
    sensor. The nominal model predicts both over a cycle. ``stall_force`` in N and ``no_load_speed`` in m/s are the ends
    of the motors' speed-torque line: while the cable is wound up, F_c/stall_force + speed/no_load_speed stays below 1.
    ``pushing_force`` in N bounds -F_c: the model's length follows a cable that pushes, which a real one cannot do.
    """

    cable_speed: float = math.inf
    cable_force: float = math.inf
    electrical_power: float = math.inf
    stall_force: float = math.inf
    no_load_speed: float = math.inf
    pushing_force: float = math.inf

    def __post_init__(self) -> None:
        for name, value in dataclasses.asdict(self).items():
            if not value > 0.0:
                raise OptimizerError(f"limits: {name} = {value}: give a positive number")

    @property
    def need_simulation(self) -> bool:
        """True if a limit is set that needs a simulated cycle."""
        simulated = self.cable_force, self.electrical_power, self.stall_force, self.pushing_force
        return any(math.isfinite(limit) for limit in simulated)

    def tightened(self, other: ActuatorLimits) -> ActuatorLimits:
        """Return the smaller of both limits for each quantity."""
        pairs = zip(dataclasses.astuple(self), dataclasses.astuple(other), strict=True)
        return ActuatorLimits(*(min(pair) for pair in pairs))

    def ratios(self, speed: Array, peak: Peaks) -> dict[str, Array]:
        """Return each quantity over its limit, by name of the limit; ``speed`` of the cable in m/s of shape (n,)."""
        return {
            "cable_speed": speed / self.cable_speed,
            "cable_force": peak.force / self.cable_force,
            "electrical_power": peak.power / self.electrical_power,
            "stall_force and no_load_speed": peak.motor_load,
            "pushing_force": peak.push / self.pushing_force,
        }

    def excess(self, speed: Array, peak: Peaks) -> Array:
        """Return the largest relative excess over the limits, at most 0 if all are satisfied; see `ratios`."""
        return np.max(list(self.ratios(speed, peak).values()), axis=0) - 1.0

    def description(self) -> str:
        """Return the limits that are set as text; empty without limits."""
        texts = {
            "cable_speed": "cable speed {:.3g} m/s",
            "cable_force": "cable force {:.3g} N",
            "electrical_power": "power {:.3g} W",
            "stall_force": "stall at {:.3g} N",
            "no_load_speed": "no load at {:.3g} m/s",
            "pushing_force": "pushing force {:.3g} N",
        }
        values = dataclasses.asdict(self)
        return ", ".join(
            text.format(values[name]) for name, text in texts.items() if math.isfinite(values[name])
        )


NO_LIMITS = ActuatorLimits()


@dataclass(frozen=True)
class Peaks:
    """Largest cable force in N, power in W and load (1) relative to the motors' line in a cycle, each of shape (n,).

    ``push`` is the largest force in N with which the cable would have to push, 0 if it always pulls. ``mean_force`` is
    the mean pull of the cable in N.
    """

    force: Array
    power: Array
    motor_load: Array
    push: Array
    mean_force: Array

    @staticmethod
    def none(count: int) -> Peaks:
        """Return peaks of zero, for limits that need no simulation."""
        return Peaks(*np.zeros((len(dataclasses.fields(Peaks)), count)))


def peaks(
    stroke: ArrayLike,
    frequency: ArrayLike,
    direction: int,
    parameters: Parameters,
    limits: ActuatorLimits = NO_LIMITS,
    shape: Shapes = SINUSOID,
) -> Peaks:
    """Return the peaks over a periodic cycle of gaits, ``stroke`` in m and ``frequency`` in Hz of shape (n,).

    ``limits`` contain the ends of the motors' line. The peaks are NaN for gaits that the simulator cannot evaluate.
    """
    shapes = np.broadcast_to(shape, np.shape(stroke))
    phases = sample_phases(shapes, _SAMPLES)
    force, power = sample_cycle(
        stroke, frequency, direction, parameters, _CYCLE, phases, **fields_of(shapes)
    )
    pulled = pull_rate(shapes, phases) * np.multiply(frequency, stroke)[:, np.newaxis]
    pull = np.maximum(force, 0.0)
    around = np.column_stack([phases[:, -1] - 1.0, phases, phases[:, 0] + 1.0])
    shares = 0.5 * (around[:, 2:] - around[:, :-2])  # of the cycle, which each sample represents
    load = np.where(pulled > 0.0, pull / limits.stall_force + pulled / limits.no_load_speed, 0.0)
    return Peaks(
        force=force.max(axis=1),
        power=power.max(axis=1),
        motor_load=load.max(axis=1),
        push=np.maximum(-force, 0.0).max(axis=1),
        mean_force=np.sum(shares * pull, axis=1),
    )


def describe_limit(
    limits: ActuatorLimits,
    stroke: Array,
    frequency: Array,
    direction: int,
    parameters: Parameters,
    shape: Shapes = SINUSOID,
) -> str:
    """Return a text that names the limit that excludes all of some gaits, and the least value that they need.

    ``stroke`` in m and ``frequency`` in Hz of shape (n,), at least one gait, of which none satisfies all limits.
    """
    peak = peaks(stroke, frequency, direction, parameters, limits, shape)
    speed = peak_rate(shape) * stroke * frequency
    least = {name: float(np.nanmin(each)) for name, each in limits.ratios(speed, peak).items()}
    name, ratio = max(least.items(), key=lambda item: item[1])
    if ratio > 1.0:
        return (
            f"limits: {name} excludes every gait that moves: the least demanding one needs {ratio:.3g} times the limit "
            f"({limits.description()}): raise it"
        )
    return f"limits: no gait that moves satisfies all of {limits.description()}: raise one of them"
