# SPDX-License-Identifier: Apache-2.0
"""Recordings of gaits for tests, with the messages that driver and tracker would publish."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from worm_model.bags.formats.bag_writer import new_bag
from worm_model.bags.run_writer import write_run
from worm_model.gait import Gait
from worm_model.parameters import PAPER, Parameters
from worm_model.run import (
    Activity,
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
SERIES = ("gait_state", "commanded", "measured", "tracker", "power")
HIDDEN = (
    40,
    44,
)  # first camera sample in which the rear marker is hidden, and the next one in which it is not

Columns = tuple[np.ndarray, ...]


def make_run(
    gait: Gait,
    onset: float,
    camera: Columns,
    command: Columns,
    power: Columns,
    *,
    cycles: int = 5,
    end: float | None = None,
    epoch: int = EPOCH,
) -> Run:
    """Return the recording of (time, x1, x2), (time, u_cmd) and (time, power), in s after the epoch, m and W.

    The driver rests from the first command on, and begins the gait at ``onset``. If the recording contains its ``end``,
    the driver also reports the start of each further cycle.
    """

    def stamps(time: np.ndarray) -> np.ndarray:
        return epoch + np.rint(np.asarray(time) * 1e9).astype(np.int64)

    x1, x2 = camera[1:]
    resting, seen = camera[0] < onset, np.isfinite(x2 - x1)
    initial = float(np.nanmedian((x2 - x1)[resting])) if resting.any() else PAPER.initial_length
    length, volts = (x2 - x1)[seen], np.full(power[0].size, 12.0)
    begun = 1 if end is None else cycles
    rows = [(command[0][0], Activity.RESTING, 0)]
    rows += [(onset + k * gait.period, Activity.RUNNING, k + 1) for k in range(begun)]
    rows += [] if end is None else [(end, Activity.IDLE, cycles)]
    times, states, cycle = (np.array(column) for column in zip(*rows, strict=True))
    return Run(
        origin=int(min(stamps(command[0][:1]), stamps(camera[0][:1]))[0]),
        commanded=LengthSamples(stamps(command[0]), initial + command[1], command[1]),
        measured=LengthSamples(stamps(camera[0])[seen], length, length - initial),
        tracker=TrackerSamples(stamps(camera[0]), x1, x2),
        power=PowerSamples(
            stamps(power[0]), np.zeros(volts.size, np.int64), volts, power[1] / volts, power[1]
        ),
        gait_state=GaitStates.of(
            gait,
            stamps(times),
            state=states,
            onset=np.where(cycle > 0, stamps(onset), 0),
            cycle=cycle,
            cycles=np.full(cycle.size, cycles),
        ),
    )


@dataclass(frozen=True)
class Instruments:
    """Noise of camera (m) and power sensor (W), delay of the camera's clock (s), rate of the power (Hz), rest (s)."""

    camera_noise: float = 0.0002
    power_noise: float = 0.02
    camera_behind: float = 0.0
    power_rate: float = 50.0
    rest: float = 2.0
    hidden: tuple[int, int] = (0, 0)


def exact_run(
    gait: Gait,
    parameters: Parameters = PAPER,
    instruments: Instruments = Instruments(),
    seed: int = 0,
    duration: float = 12.0,
    cycles: int | None = None,
) -> Run:
    """Return a run of a robot that follows the model exactly, and that stops after the cycles, if any are given."""
    random = np.random.default_rng(seed)
    rest, last = instruments.rest, np.inf if cycles is None else cycles * gait.period
    trajectory = simulate(
        gait, parameters, cycles or int(np.ceil((duration + 1.0) * gait.frequency))
    )

    def of_gait(time: np.ndarray) -> np.ndarray:
        return np.clip(time - rest, 0.0, last)

    camera = np.arange(0.003, rest + duration, 1.0 / 30.0)  # between the other samples
    command = np.arange(0.0, rest + duration, 0.02)
    power = np.arange(0.0, rest + duration, 1.0 / instruments.power_rate)
    motion = trajectory.at(of_gait(camera + instruments.camera_behind))
    noise = random.normal(0.0, instruments.camera_noise, (2, camera.size))
    noise[0, slice(*instruments.hidden)] = np.nan
    moving = (power > rest) & (power < rest + last)
    watts = np.where(moving, trajectory.at(of_gait(power)).power, parameters.idle_power)
    return make_run(
        gait,
        rest,
        (camera, motion.x1 + noise[0], motion.x2 + noise[1]),
        (command, gait.command(of_gait(command))),
        (power, watts + random.normal(0.0, instruments.power_noise, power.size)),
        cycles=cycles or 5,
        end=cycles and rest + last,
    )


def simulated_run(cycles: int = 2, seed: int = 0) -> Run:
    """Return rest and some cycles of `GAIT`, with a little noise and an occlusion."""
    instruments = Instruments(1e-4, 0.05, rest=REST_S, hidden=HIDDEN)
    duration = cycles * GAIT.period + AFTER_S
    return exact_run(GAIT, PAPER, instruments, seed, duration, cycles)


def write_bag(path: Path, run: Run, namespace: str = "/worm") -> Path:
    """Write the run as a bag."""
    with new_bag(path) as writer:
        writer.add_metadata("worm_run", {"made_by": "tests/helpers/recorded_run.py"})
        write_run(writer, run, namespace)
    return path


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
