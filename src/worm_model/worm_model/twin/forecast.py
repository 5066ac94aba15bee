# SPDX-License-Identifier: Apache-2.0
"""Forecast of a gait: its motion from the twin's present state on, and the results of a run from rest."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from worm_model.arrays import Array
from worm_model.gait import Gait
from worm_model.run import Activity
from worm_model.simulation import simulator
from worm_model.simulation.closed_form import groove_phase
from worm_model.twin.core.memory import Memory
from worm_model.twin.data.samples import DriverState
from worm_model.twin.record_changes import turn_fins
from worm_model.twin.run_start import begin_run, motion_of
from worm_model.twin.twin import Twin, TwinState

HORIZON_S = 10.0  # default horizon
LONGEST_S = 120.0  # longest horizon
REST_NS = 2_500_000_000  # usual time from the turning of the fins to the onset
STEP_S = 0.02  # time step of the predicted motion


class ForecastError(ValueError):
    """The simulation of the gait failed, or the horizon is inadmissible."""


@dataclass(frozen=True)
class Forecast:
    """Predicted values of a gait.

    Attributes:
        robust: result of a run from rest, with the gait's margin.
        nominal: result of a run from rest, without the margin.
        time: time since now, s, shape (n,); for a gait in the other direction, time since its onset.
        rear_position: x1 in the tracker's frame, m, shape (n,).
        front_position: x2 in the tracker's frame, m, shape (n,).
        power: predicted source power, W, shape (n,).
        energy: energy over the horizon, J.
        grooves: grooves that the rear anchor gains over the horizon, along the gait's direction.
        groove_phase: groove phase of the L0 that the twin uses, m.
    """

    robust: simulator.GaitResult
    nominal: simulator.GaitResult
    time: Array
    rear_position: Array
    front_position: Array
    power: Array
    energy: float
    grooves: int
    groove_phase: float


def forecast(twin: Twin, state: TwinState, gait: Gait, horizon_s: float = HORIZON_S) -> Forecast:
    """Return the forecast of a gait for a horizon in s, where 0 means `HORIZON_S`.

    Raises:
        ForecastError: A fin chatters, the fins do not hold the load at rest, or the horizon is not in the range from
            `STEP_S` to `LONGEST_S`.
        GaitError: Stroke plus pretension is not below the body length.
    """
    horizon = horizon_s or HORIZON_S
    if not STEP_S <= horizon <= LONGEST_S:
        raise ForecastError(f"horizon: {horizon_s:g} s is not between {STEP_S} and {LONGEST_S:g} s")
    try:
        begun, start = _start(twin, state, gait)
        parameters = twin.effective_parameters(begun)
        robust = simulator.evaluate_gait(gait, parameters)
        nominal = simulator.evaluate_gait(replace(gait, margin=0.0), parameters)
        time: Array = np.arange(1, round(horizon / STEP_S) + 1, dtype=float) * STEP_S
        motions = simulator.play_gait(gait, parameters, start, time)
    except (simulator.LoadError, simulator.SimulationError) as error:
        raise ForecastError(f"the gait cannot be predicted: {error}") from None
    origin = float(begun.record["origin"]) + int(begun.record["moved"]) * parameters.pitch
    return Forecast(
        robust=robust,
        nominal=nominal,
        time=time,
        rear_position=origin + motions.x1,
        front_position=origin + motions.x2,
        power=motions.power,
        energy=float(motions.energy[-1]),
        grooves=gait.direction * (int(motions.rear_groove[-1]) - start.rear_groove),
        groove_phase=groove_phase(parameters),
    )


def _start(twin: Twin, state: TwinState, gait: Gait) -> tuple[TwinState, simulator.LocomotionState]:
    """Return the state of the twin, and the motion of the robot at the onset of a gait that begins now.

    For a gait in the other direction, the fins are turned now, and the robot rests in their new grooves at the onset.
    """
    if gait.direction != state.direction:
        memory = Memory(**{name: part.copy() for name, part in state.memory._asdict().items()})
        turn_fins(memory.record[0])
        onset = int(memory.record[0]["processed_ns"]) + REST_NS
        driver = DriverState(onset, Activity.RUNNING, gait, onset)
        begin_run(memory, driver, twin.parameters, state.starts)
        state = replace(state, memory=memory)
    elif state.record["moving"]:
        return state, motion_of(state.record)
    m, model = state.record, simulator.Locomotion(twin.effective_parameters(state), gait.direction)
    pose = float(m["answer"]), float(m["pose_x1"]), int(m["pose_front"])
    return state, model.start(0.0, *pose)
