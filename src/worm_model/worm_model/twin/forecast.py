# SPDX-License-Identifier: Apache-2.0
"""What if: a gait that would begin now, from the twin's present pose and length."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from worm_model.gait import Gait
from worm_model.parameters import Parameters
from worm_model.simulation.actuation import effective_command, length_change_of_command
from worm_model.simulation.closed_form import groove_phase
from worm_model.simulation.simulator import (
    GaitResult,
    Locomotion,
    LocomotionState,
    SimulationError,
    evaluate_gait,
)
from worm_model.twin.core import Twin
from worm_model.twin.track import power_at_rate
from worm_model.twin.twin_state import TwinState

Array = NDArray[np.float64]

HORIZON_S = 10.0
LONGEST_S = 120.0
STEP_S = 0.02


class ForecastError(ValueError):
    """Nothing can be predicted; the message says why and what to do."""


@dataclass(frozen=True)
class Forecast:
    """Figures of the gait from rest with its margin (``robust``) and without (``nominal``), and what comes next.

    ``time`` (n,) in s from now; positions (n,) in m in the tracker's frame; ``power`` (n,) in W; ``energy`` in J;
    ``grooves`` gained by the rear anchor along the gait's direction; ``groove_phase`` in m.
    """

    robust: GaitResult
    nominal: GaitResult
    time: Array
    rear_position: Array
    front_position: Array
    power: Array
    energy: float
    grooves: int
    groove_phase: float


def forecast(twin: Twin, state: TwinState, gait: Gait, horizon_s: float = HORIZON_S) -> Forecast:
    """Predicts a gait; a horizon of 0 means ten seconds. Raises `ForecastError`."""
    horizon = horizon_s or HORIZON_S
    if not STEP_S <= horizon <= LONGEST_S:
        raise ForecastError(f"horizon: {horizon_s:g} s is not between {STEP_S} and {LONGEST_S:g} s")
    parameters = twin.effective_parameters(state)
    try:
        robust = evaluate_gait(gait, parameters)
        nominal = evaluate_gait(replace(gait, margin=0.0), parameters)
        return _ahead(twin, state, gait, horizon, (robust, nominal))
    except SimulationError as error:
        raise ForecastError(f"the gait cannot be predicted: {error}") from None


def _ahead(
    twin: Twin, state: TwinState, gait: Gait, horizon: float, figures: tuple[GaitResult, GaitResult]
) -> Forecast:
    parameters = twin.effective_parameters(state)
    model = Locomotion(parameters, gait.direction)
    motion, origin = _present(state, model, parameters)
    time: Array = np.arange(1, round(horizon / STEP_S) + 1, dtype=float) * STEP_S
    changes, rates = _answer(motion.length_change, time, gait, parameters)
    after, motions = model.follow(motion, motion.time + time, changes)
    power = power_at_rate(motions.cable_force, motions.length_rate, rates, parameters)
    return Forecast(
        robust=figures[0],
        nominal=figures[1],
        time=time,
        rear_position=origin + motions.x1,
        front_position=origin + motions.x2,
        power=power,
        energy=float(np.sum(power) * STEP_S),
        grooves=gait.direction * (after.rear_groove - motion.rear_groove),
        groove_phase=groove_phase(parameters),
    )


def _present(
    state: TwinState, model: Locomotion, parameters: Parameters
) -> tuple[LocomotionState, float]:
    """The motion from which the gait would begin, and the tracker's position of its zero."""
    if state.track is None:
        return model.start(), state.run.origin
    moved = state.anchors.grooves_at(state.track.stamp_ns)
    return state.track.motion, state.run.origin + moved * parameters.pitch


def _answer(
    length_change: float, time: Array, gait: Gait, parameters: Parameters
) -> tuple[Array, Array]:
    """ΔL in m and its rate in m/s at the times, the command beginning at 0 from the present length."""
    command = np.array([gait.command(moment) for moment in time.tolist()])
    times, commands = np.concatenate([[0.0], time]), np.concatenate([[0.0], command])
    changes = length_change_of_command(times, commands, parameters, length_change)[1:]
    target = parameters.gain * effective_command(command, parameters.slack)
    return changes, (target - changes) / parameters.time_constant
