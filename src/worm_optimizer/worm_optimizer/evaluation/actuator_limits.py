# SPDX-License-Identifier: Apache-2.0
"""Limits of the actuators and of the power sensor, as optional constraints on gaits."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from worm_model.arrays import Array
from worm_model.errors import InputError
from worm_model.parameters import Parameters
from worm_optimizer.evaluation.command_shape import (
    SINUSOID,
    Shapes,
    fields_of,
    peak_rates,
    pull_rate,
    sample_phases,
)

_CYCLE = 2  # index of the sampled cycle, from 0. From the third cycle on, usually only the positions differ.
_SAMPLES = 400  # number of samples of force and power in that cycle


@dataclass(frozen=True)
class ActuatorLimits:
    """Largest values that a gait may require of the hardware; infinity means no limit.

    The nominal model predicts force and power over a cycle.

    Attributes:
        cable_speed: bound of the commanded cable speed (π·f·S for a sinusoid), m/s.
        cable_force: bound of the cable force F_c (eq:Fc), N.
        electrical_power: bound of the source power P (eq:power_model), such as the range of its sensor, W.
        stall_force, no_load_speed: ends of the motors' speed-torque line in N and m/s. While the cable is wound up,
            F_c/stall_force + speed/no_load_speed must not exceed 1.
        pushing_force: bound of −F_c, N. A real cable cannot push, but in the model the body follows a pushing cable.
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
                raise InputError(f"limits: {name} = {value}: give a positive number")

    @property
    def need_simulation(self) -> bool:
        """True if a limit is set whose check needs a simulated cycle."""
        return dataclasses.replace(self, cable_speed=math.inf) != NO_LIMITS

    def tightened(self, other: ActuatorLimits) -> ActuatorLimits:
        """Return limits with the smaller value of ``self`` and ``other`` for each quantity."""
        pairs = zip(dataclasses.astuple(self), dataclasses.astuple(other), strict=True)
        return ActuatorLimits(*(min(pair) for pair in pairs))

    def ratios(self, speed: Array, peak: Peaks) -> dict[str, Array]:
        """Return the ratio of each quantity to its limit, by name of the limit, shape (n,) each.

        ``speed`` is the largest cable speed in m/s, shape (n,), and ``peak`` contains the other quantities.
        """
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
    """Extremes of gaits in a cycle; every field has shape (n,).

    Attributes:
        force: largest cable force, N.
        power: largest source power, W.
        motor_load: largest F_c/stall_force + speed/no_load_speed while the cable is wound up, see `ActuatorLimits`.
        push: largest force with which the cable would have to push, N; 0 if it always pulls.
    """

    force: Array
    power: Array
    motor_load: Array
    push: Array

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
    """Return the peaks of gaits over a cycle in the periodic state; NaN for gaits that the simulator cannot evaluate.

    ``stroke`` in m and ``frequency`` in Hz have shape (n,). Of ``limits``, only the ends of the motors' speed-torque
    line are used.
    """
    from worm_model.simulation.batch import sample_cycle  # here: Numba loads slowly

    shapes = np.broadcast_to(shape, np.shape(stroke))
    phases = sample_phases(shapes, _SAMPLES)
    force, power = sample_cycle(
        stroke, frequency, direction, parameters, _CYCLE, phases, **fields_of(shapes)
    )
    pulled = pull_rate(shapes, phases) * np.multiply(frequency, stroke)[:, np.newaxis]
    pull = np.maximum(force, 0.0)
    load = np.where(pulled > 0.0, pull / limits.stall_force + pulled / limits.no_load_speed, 0.0)
    return Peaks(
        force=force.max(axis=1),
        power=power.max(axis=1),
        motor_load=load.max(axis=1),
        push=np.maximum(-force, 0.0).max(axis=1),
    )


def describe_limit(
    limits: ActuatorLimits,
    stroke: Array,
    frequency: Array,
    direction: int,
    parameters: Parameters,
    shape: Shapes = SINUSOID,
) -> str:
    """Return an error text that names the limit because of which none of the given gaits is admissible.

    The text also contains by how much the least demanding gait exceeds this limit. If no single limit excludes all
    gaits, the text names all limits. ``stroke`` in m and ``frequency`` in Hz have shape (n,), n ≥ 1.
    """
    peak = peaks(stroke, frequency, direction, parameters, limits, shape)
    speed = peak_rates(shape) * stroke * frequency
    least = {name: float(np.nanmin(each)) for name, each in limits.ratios(speed, peak).items()}
    name, ratio = max(least.items(), key=lambda item: item[1])
    if ratio > 1.0:
        return (
            f"limits: {name} excludes every gait that moves: the least demanding one needs {ratio:.3g} times the limit "
            f"({limits.description()}): raise this limit"
        )
    return f"limits: no gait that moves satisfies all of {limits.description()}: raise one of them"
