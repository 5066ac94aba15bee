# SPDX-License-Identifier: Apache-2.0
"""Speed, relative to real time, of reading a bag, replaying it, and writing it with the twin's topics."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from benchmarks.report import Row, wall_time
from worm_model.analysis.replay_metrics import ReplayReporter
from worm_model.bags.formats.bag_writer import new_bag
from worm_model.bags.opening import open_bag
from worm_model.bags.run_reader import read_parts, read_run
from worm_model.bags.run_writer import write_run
from worm_model.bags.worm_topics import TWIN_INPUTS
from worm_model.commands.replay import write_replay
from worm_model.gait import Gait
from worm_model.parameters import PAPER
from worm_model.run import GaitStates, LengthSamples, PowerSamples, Run, TrackerSamples
from worm_model.simulation.simulator import simulate
from worm_model.twin import warm_up
from worm_model.twin.offline_replay import OfflineReplay

TITLE = "times real time of reading a bag and replaying it into the twin"

GAIT = Gait(0.07, 0.2)
REST_S = 2.0
REPEATS = 5
EPOCH = 1_800_000_000 * 10**9


def run() -> list[Row]:
    """Measure a run of five cycles, and one of ten minutes."""
    warm_up.main()
    return [row for cycles in (5, 120) for row in _measure(cycles)]


def _measure(cycles: int) -> list[Row]:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "bag")
        recorded = _simulated_run(cycles)
        with new_bag(path) as writer:
            write_run(writer, recorded)
        duration = (recorded.power.stamp[-1] - recorded.origin) * 1e-9

        def read() -> Run:
            with open_bag(path) as bag:
                return read_run(bag, names=TWIN_INPUTS)

        def report() -> None:
            found = read()
            replay = OfflineReplay(lambda: (found,), PAPER)
            reporter = replay.feed(lambda: ReplayReporter(replay.samples, PAPER.pitch))
            reporter.report(replay.unusable)

        def publish() -> None:
            with open_bag(path) as bag:
                output = Path(folder, f"output_{len(list(Path(folder).iterdir()))}")
                parts = read_parts(bag, "", TWIN_INPUTS)
                write_replay(bag, output, OfflineReplay(lambda: parts, PAPER), "/worm")

        name = f"a bag of {duration:.0f} s"
        calls = (
            ("read", read, "", REPEATS),
            ("read, follow, report", report, "300", REPEATS),
            ("the same, to a new bag with the twin's topics", publish, "100", REPEATS),
        )
        return [
            Row(
                f"{name}: {what}",
                _factor(duration, wall_time(call, times)),
                goal,
                f"median of {times}, clock time",
            )
            for what, call, goal, times in calls
        ]


def _factor(duration: float, elapsed: float) -> str:
    return f"{duration / elapsed:.0f} times real time"


def _simulated_run(cycles: int) -> Run:
    """Return commands and power at 100 Hz and tracker samples at 30 Hz, with the rates of driver and virtual robot."""
    end = REST_S + cycles * GAIT.period
    fast, slow = np.arange(0.0, end, 0.01), np.arange(0.003, end, 1.0 / 30.0)
    trajectory = simulate(GAIT, cycles=cycles)
    moving = trajectory.at(np.clip(slow - REST_S, 0.0, None))
    power = trajectory.at(np.clip(fast - REST_S, 0.0, None)).power
    phase = 2.0 * np.pi * GAIT.frequency * np.clip(fast - REST_S, 0.0, None)
    command = -0.5 * GAIT.stroke * (1.0 - np.cos(phase))
    length = moving.x2 - moving.x1
    count = cycles + 1
    cycle = np.arange(count)
    times = np.concatenate([[0.0], REST_S + np.arange(cycles) * GAIT.period])
    return Run(
        origin=EPOCH,
        commanded=LengthSamples(_stamp(fast), PAPER.initial_length + command, command),
        measured=LengthSamples(_stamp(slow), length, length - PAPER.initial_length),
        tracker=TrackerSamples(_stamp(slow), moving.x1, moving.x2),
        power=PowerSamples(
            _stamp(fast), np.zeros(fast.size, np.int64), 0 * power + 12.0, power / 12.0, power
        ),
        gait_state=GaitStates(
            stamp=_stamp(times),
            state=np.where(cycle == 0, 2, 3),
            stroke=np.full(count, GAIT.stroke),
            frequency=np.full(count, GAIT.frequency),
            direction=np.full(count, GAIT.direction),
            margin=np.full(count, GAIT.margin),
            onset=np.where(cycle == 0, 0, EPOCH + round(REST_S * 1e9)),
            cycle=cycle,
            cycles=np.full(count, cycles),
        ),
    )


def _stamp(time: np.ndarray) -> np.ndarray:
    return EPOCH + np.rint(time * 1e9).astype(np.int64)
