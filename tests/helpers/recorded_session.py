# SPDX-License-Identifier: Apache-2.0
"""Two gaits in one session of the virtual robot's plant: the second begins with fins that the first has deflected."""

import dataclasses
import itertools

import numpy as np
from recorded_run import EPOCH, GAIT, IDLE, INITIAL_LENGTH, RESTING, RUNNING

from worm_driver.virtual_robot.plant import Plant, PlantEffects, make_grooves
from worm_model.gait import FORWARD
from worm_model.parameters import PAPER
from worm_model.run import GaitStates, LengthSamples, PowerSamples, Run, TrackerSamples
from worm_msgs.robot_parameters import RobotParameters

STEP_S, REST_S, PAUSE_S = 1e-3, 2.0, 6.0
POWER_W = 1.5  # constant, as this robot's power sensor is a dummy


def recorded_session(cycles: tuple[int, int] = (4, 5)) -> tuple[Run, Run]:
    """Return two recordings of `GAIT`, cut in the rest between; the second continues at the positions of the first."""
    first, again = 0.0, cycles[0] * GAIT.period + PAUSE_S
    end = again + cycles[1] * GAIT.period + 0.3
    time = np.arange(round(-REST_S / STEP_S), round(end / STEP_S)) * STEP_S
    phase = np.zeros_like(time)
    for onset, count in ((first, cycles[0]), (again, cycles[1])):
        running = (time >= onset) & (time < onset + count * GAIT.period)
        phase[running] = 2.0 * np.pi * GAIT.frequency * (time[running] - onset)
    command = -0.5 * GAIT.stroke * (1.0 - np.cos(phase))
    positions = _positions(command)
    cut = again - 0.5 * PAUSE_S
    return (
        _run(time, command, positions, (-REST_S, cut), (first, cycles[0])),
        _run(time, command, positions, (cut, end), (again, cycles[1])),
    )


def joined_session() -> Run:
    """Return the same as one recording of both gaits."""
    first, second = recorded_session()
    series = {}
    for field in dataclasses.fields(Run):
        parts = getattr(first, field.name), getattr(second, field.name)
        if field.name in ("commanded", "measured", "tracker", "power", "gait_state"):
            columns = zip(*(vars(part).items() for part in parts), strict=True)
            series[field.name] = type(parts[0])(
                **{name: np.concatenate([a, b]) for (name, a), (_, b) in columns}
            )
    return Run(origin=first.origin, **series)


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


def _run(
    time: np.ndarray,
    command: np.ndarray,
    positions: np.ndarray,
    span: tuple[float, float],
    played: tuple[float, int],
) -> Run:
    inside = np.flatnonzero((time >= span[0]) & (time < span[1]))
    fast, slow = inside[::20], inside[::33]
    stamp = EPOCH + np.rint(time * 1e9).astype(np.int64)
    x1, x2 = positions[slow].T
    onset, cycles = played
    begins = EPOCH + round(onset * 1e9)
    power = np.full(fast.size, POWER_W)
    return Run(
        origin=int(stamp[inside[0]]),
        commanded=LengthSamples(stamp[fast], INITIAL_LENGTH + command[fast], command[fast]),
        measured=LengthSamples(stamp[slow], x2 - x1, x2 - x1 - INITIAL_LENGTH),
        tracker=TrackerSamples(stamp[slow], x1, x2),
        power=PowerSamples(
            stamp[fast], np.zeros(fast.size, np.int64), 12.0 + 0 * power, power / 12.0, power
        ),
        gait_state=GaitStates.of(
            GAIT,
            begins + np.array([-1_500_000_000, 0, round(cycles * GAIT.period * 1e9)]),
            state=np.array([RESTING, RUNNING, IDLE]),
            onset=np.array([0, begins, begins]),
            cycle=np.array([0, 1, cycles]),
            cycles=np.full(3, cycles),
        ),
    )
