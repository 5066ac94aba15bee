# SPDX-License-Identifier: Apache-2.0
"""A small simulated run for tests, with the messages that driver and tracker would publish."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from worm_model.bags.formats.bag_writer import new_bag
from worm_model.bags.run_writer import write_run
from worm_model.gait import Gait
from worm_model.run import (
    GaitStates,
    LengthSamples,
    PowerSamples,
    Run,
    TrackerSamples,
    concatenated,
)
from worm_model.simulation.simulator import simulate

EPOCH = 1_800_000_000_000_000_000
REST_S, AFTER_S = 1.5, 0.3  # at rest before the gait, and recorded after it
GAIT = Gait(0.07, 0.4)
INITIAL_LENGTH = 0.2952
RESTING, RUNNING, IDLE = 2, 3, 1
SERIES = ("gait_state", "commanded", "measured", "tracker", "power")


def simulated_run(cycles: int = 2, seed: int = 0) -> Run:
    """Return rest and some cycles, with a little noise and two occlusions.

    Commands and power have 50 Hz, the tracker has 30 Hz.
    """
    draw = np.random.default_rng(seed)
    end = REST_S + cycles * GAIT.period + AFTER_S
    fast, slow = np.arange(0.0, end, 0.02), np.arange(0.003, end, 1.0 / 30.0)
    trajectory = simulate(GAIT, cycles=cycles)
    moving = trajectory.at(np.clip(slow - REST_S, 0.0, cycles * GAIT.period))
    power = trajectory.at(np.clip(fast - REST_S, 0.0, cycles * GAIT.period)).power
    x1 = moving.x1 + draw.normal(0.0, 1e-4, slow.size)
    x2 = moving.x2 + draw.normal(0.0, 1e-4, slow.size)
    x1[40:44] = np.nan
    phase = 2.0 * np.pi * GAIT.frequency * np.clip(fast - REST_S, 0.0, cycles * GAIT.period)
    command = -0.5 * GAIT.stroke * (1.0 - np.cos(phase))
    seen = np.isfinite(x1)
    length = (x2 - x1)[seen]
    power = power + draw.normal(0.0, 0.05, fast.size)
    return Run(
        origin=EPOCH,
        commanded=LengthSamples(_stamp(fast), INITIAL_LENGTH + command, command),
        measured=LengthSamples(_stamp(slow)[seen], length, length - INITIAL_LENGTH),
        tracker=TrackerSamples(_stamp(slow), x1, x2),
        power=power_samples(_stamp(fast), power),
        gait_state=_gait_states(cycles, end),
    )


def power_samples(stamp: np.ndarray, power: np.ndarray) -> PowerSamples:
    """Return valid samples of a power in W at 12 V."""
    volts = np.full(power.size, 12.0)
    return PowerSamples(stamp, np.zeros(power.size, np.int64), volts, power / volts, power)


def _stamp(time: np.ndarray) -> np.ndarray:
    return EPOCH + np.rint(time * 1e9).astype(np.int64)


def _gait_states(cycles: int, end: float) -> GaitStates:
    begins = REST_S + np.arange(cycles) * GAIT.period
    times = np.concatenate([[0.0], begins, [end - 0.1]])
    cycle = np.array([0, *range(1, cycles + 1), cycles])
    return GaitStates.of(
        GAIT,
        _stamp(times),
        state=np.array([RESTING, *[RUNNING] * cycles, IDLE]),
        onset=np.where(cycle > 0, int(_stamp(np.array(REST_S))), 0),
        cycle=cycle,
        cycles=np.full(times.size, cycles),
    )


def later(run: Run, by: int, moved: float = 0.0) -> Run:
    """Return the same run of a robot that was moved by a distance in m, later by some ns."""
    states, tracker = run.gait_state, run.tracker
    series = {
        name: replace(getattr(run, name), stamp=getattr(run, name).stamp + by)
        for name in ("commanded", "measured", "power")
    }
    places = (tracker.rear_position + moved, tracker.front_position + moved)
    onset = np.where(states.onset > 0, states.onset + by, 0)
    return replace(
        run,
        origin=run.origin + by,
        gait_state=replace(states, stamp=states.stamp + by, onset=onset),
        tracker=TrackerSamples(tracker.stamp + by, *places),
        **series,
    )


def joined(runs: Sequence[Run]) -> Run:
    """Return runs, one after the other, as one recording."""
    series = {
        name: concatenated(type(getattr(runs[0], name)), [getattr(run, name) for run in runs])
        for name in SERIES
    }
    return Run(origin=runs[0].origin, **series)


def write_bag(path: Path, run: Run, namespace: str = "/worm") -> Path:
    """Write the run as a bag."""
    with new_bag(path) as writer:
        writer.add_metadata("worm_run", {"made_by": "tests/helpers/recorded_run.py"})
        write_run(writer, run, namespace)
    return path
