# SPDX-License-Identifier: Apache-2.0
"""Tuning of gaits on the robot: run a gait, measure its margins, and repeat with the next gait."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from worm_model.gait import Gait
from worm_optimizer.operation.bring_up import CYCLES, Say
from worm_optimizer.operation.campaign_runs import Prepare, gait_recorder, is_recorded
from worm_optimizer.operation.system import Robot
from worm_optimizer.robot_commands import GaitCommand
from worm_optimizer.robustness.tuning import TuneState, Tuning

MOST_RUNS = 5
TUNING = "tuning"  # folder of a campaign's bags

#: Runs a gait and returns its bag. Arguments: the gait, and the number of the run from 1. Raises an exception to end.
Record = Callable[[Gait, int], Path]
#: Returns the next step from the bags so far. Raises an exception if the last run was not measured.
Measure = Callable[[Sequence[Path]], Tuning]


@dataclass(frozen=True)
class Tuned:
    """Last step of a tuning, and the bags of its runs. In the state `RUN` the runs did not suffice."""

    step: Tuning
    bags: tuple[Path, ...]


def tune_gait(gait: Gait, record: Record, measure: Measure, say: Callable[[str], None]) -> Tuned:
    """Run a gait and its successors, at most `MOST_RUNS` in total, until one is done or none is possible.

    Args:
        gait: the first gait.
        record: runs and records a gait.
        measure: the step after the bags so far.
        say: called with each line of progress.
    """
    bags: list[Path] = []
    for number in range(1, MOST_RUNS + 1):
        say(
            f"run {number} of at most {MOST_RUNS}: {1e3 * gait.stroke:.1f} mm, {gait.frequency:.4g} Hz"
        )
        bags.append(record(gait, number))
        step = measure(bags)
        if step.state is not TuneState.RUN:
            break
        gait = step.gait
    return Tuned(step, tuple(bags))


def tune_gaits(
    robot: Robot,
    gaits: Mapping[str, tuple[Gait, Measure]],
    folder: Path,
    logs: Path,
    say: Say,
    prepare: Prepare,
) -> dict[str, Tuned]:
    """Tune gaits one after the other, with run N recorded as ``folder/tuning/NAME_N``; see `tune_gait`.

    Complete recordings of an interrupted campaign are measured again instead of run again. The robot's nodes are
    started when the first run is missing.

    Args:
        robot: the robot.
        gaits: by name, the first gait and the measurement of its bags.
        folder: folder of the campaign.
        logs: folder of the log files.
        say: called with each line of progress.
        prepare: called before each run; raises an exception to end the campaign.

    Raises:
        ProcessError, OperatorError: A stage failed. The message contains the node or service, and the reason.
    """
    runs = folder / TUNING
    runs.mkdir(parents=True, exist_ok=True)
    with ExitStack() as nodes:
        recorder = cache(lambda: nodes.enter_context(gait_recorder(robot, logs, say, prepare)))

        def tuned(name: str, first: Gait, measure: Measure) -> Tuned:
            def record(gait: Gait, number: int) -> Path:
                bag = runs / f"{name}_{number}"
                if not is_recorded(bag):
                    recorder()(bag, GaitCommand(gait, CYCLES))
                return bag

            return tune_gait(first, record, measure, say)

        return {name: tuned(name, *each) for name, each in gaits.items()}
