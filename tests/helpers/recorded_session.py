# SPDX-License-Identifier: Apache-2.0
"""Two gaits in one session of the virtual robot's plant: the second begins with fins that the first has deflected."""

import dataclasses
import itertools

import numpy as np
from recorded_run import EPOCH, GAIT, IDLE, INITIAL_LENGTH, RESTING, RUNNING, power_samples

from worm_driver.virtual_robot.plant import Plant, PlantEffects, make_grooves
from worm_model.gait import FORWARD
from worm_model.parameters import PAPER
from worm_model.run import GaitStates, LengthSamples, Run, TrackerSamples
from worm_msgs.robot_parameters import RobotParameters

STEP_S, REST_S, PAUSE_S = 1e-3, 2.0, 6.0
POWER_W = 1.5  # constant, as this robot's power sensor is a dummy
CYCLES = 4, 5


def joined_session() -> Run:
    """Return one recording of `GAIT`, played twice."""
    onsets = 0.0, CYCLES[0] * GAIT.period + PAUSE_S
    ends = [onset + count * GAIT.period for onset, count in zip(onsets, CYCLES, strict=True)]
    time = np.arange(round(-REST_S / STEP_S), round((ends[1] + 0.3) / STEP_S)) * STEP_S
    command = np.zeros_like(time)
    for onset, end in zip(onsets, ends, strict=True):
        running = (time >= onset) & (time < end)
        command[running] = GAIT.command(time[running] - onset)
    stamp = EPOCH + np.rint(time * 1e9).astype(np.int64)
    x1, x2 = _positions(command)[::33].T
    power = np.full(time[::20].size, POWER_W)
    times = [at for on, end in zip(onsets, ends, strict=True) for at in (on - 1.5, on, end)]
    begins = EPOCH + np.rint(1e9 * np.repeat(onsets, 3)).astype(np.int64)
    known, cycles = np.tile([0, 1, 1], 2), np.repeat(CYCLES, 3)
    return Run(
        origin=int(stamp[0]),
        commanded=LengthSamples(stamp[::20], INITIAL_LENGTH + command[::20], command[::20]),
        measured=LengthSamples(stamp[::33], x2 - x1, x2 - x1 - INITIAL_LENGTH),
        tracker=TrackerSamples(stamp[::33], x1, x2),
        power=power_samples(stamp[::20], power),
        gait_state=GaitStates.of(
            GAIT,
            EPOCH + np.rint(1e9 * np.array(times)).astype(np.int64),
            state=np.tile([RESTING, RUNNING, IDLE], 2),
            onset=begins * known,
            cycle=np.where(np.tile([0, 0, 1], 2), cycles, known),
            cycles=cycles,
        ),
    )


def _positions(command: np.ndarray) -> np.ndarray:
    """Return x1 and x2 (n, 2), m, of a robot with the paper's parameters and equal grooves."""
    names = (field.name for field in dataclasses.fields(RobotParameters))
    body = RobotParameters(**{name: getattr(PAPER, name) for name in names})
    effects = PlantEffects(0.0, 0.0, 1e-4, 0.5)
    grooves = make_grooves(body, effects, 0)
    plant = Plant(body, effects, grooves, grooves, STEP_S)
    states = itertools.accumulate(
        command.tolist(),
        lambda state, u: plant.step(state, u, (FORWARD, FORWARD)),
        initial=plant.at_rest(),
    )
    return np.array([plant.positions(state) for state in itertools.islice(states, 1, None)])
