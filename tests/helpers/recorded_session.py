# SPDX-License-Identifier: Apache-2.0
"""Two gaits in one session of the virtual robot's plant: the second begins with fins that the first has deflected."""

import dataclasses
import itertools

import numpy as np
from recorded_run import EPOCH, GAIT, IDLE, INITIAL_LENGTH, RESTING, RUNNING, power_samples

from worm_driver.virtual_robot.plant import Plant, PlantEffects, make_grooves
from worm_model.gait import FORWARD, Gait
from worm_model.parameters import PAPER
from worm_model.run import GaitStates, LengthSamples, Run, TrackerSamples, concatenated
from worm_msgs.robot_parameters import RobotParameters

STEP_S, REST_S, PAUSE_S = 1e-3, 2.0, 6.0
POWER_W = 1.5  # constant, as this robot's power sensor is a dummy
CYCLES = 4, 5
TURNED_S = 3.0, 3.2  # after the first gait, while the fins turn


def joined_session(second: Gait = GAIT, release_s: float = 0.5) -> Run:
    """Return one recording of `GAIT` and another gait; the slack returns ``release_s`` after the cable's last pull."""
    gaits = GAIT, second
    onsets = 0.0, CYCLES[0] * GAIT.period + PAUSE_S
    played = list(zip(gaits, onsets, CYCLES, strict=True))
    ends = [onset + count * gait.period for gait, onset, count in played]
    time = np.arange(round(-REST_S / STEP_S), round((ends[1] + 0.3) / STEP_S)) * STEP_S
    command = np.zeros_like(time)
    for gait, onset, end in zip(gaits, onsets, ends, strict=True):
        running = (time >= onset) & (time < end)
        command[running] = gait.command(time[running] - onset)
    turned = np.where(time > ends[0] + TURNED_S[1], second.direction, FORWARD)
    if second.direction != FORWARD:
        turned[(time > ends[0] + TURNED_S[0]) & (time <= ends[0] + TURNED_S[1])] = 0
    stamp = _stamp(time)
    x1, x2 = _positions(command, turned, release_s)[::33].T
    states = [
        GaitStates.of(
            gait,
            _stamp(np.array([onset - 1.5, onset, end])),
            state=np.array([RESTING, RUNNING, IDLE]),
            onset=int(_stamp(np.array(onset))) * np.array([0, 1, 1]),
            cycle=np.array([0, 1, count]),
            cycles=np.full(3, count),
        )
        for (gait, onset, count), end in zip(played, ends, strict=True)
    ]
    return Run(
        origin=int(stamp[0]),
        commanded=LengthSamples(stamp[::20], INITIAL_LENGTH + command[::20], command[::20]),
        measured=LengthSamples(stamp[::33], x2 - x1, x2 - x1 - INITIAL_LENGTH),
        tracker=TrackerSamples(stamp[::33], x1, x2),
        power=power_samples(stamp[::20], np.full(time[::20].size, POWER_W)),
        gait_state=concatenated(GaitStates, states),
    )


def _stamp(time: np.ndarray) -> np.ndarray:
    return EPOCH + np.rint(time * 1e9).astype(np.int64)


def _positions(command: np.ndarray, turned: np.ndarray, release_s: float) -> np.ndarray:
    """Return x1 and x2 (n, 2), m, of a robot with the paper's parameters, equal grooves and fins turned so."""
    names = (field.name for field in dataclasses.fields(RobotParameters))
    body = RobotParameters(**{name: getattr(PAPER, name) for name in names})
    effects = PlantEffects(0.0, 0.0, 1e-4, release_s)
    grooves = make_grooves(body, effects, 0)
    plant = Plant(body, effects, grooves, grooves, STEP_S)
    states = itertools.accumulate(
        zip(command.tolist(), turned.tolist(), strict=True),
        lambda state, step: plant.step(state, step[0], (step[1], step[1])),
        initial=plant.at_rest(),
    )
    return np.array([plant.positions(state) for state in itertools.islice(states, 1, None)])
