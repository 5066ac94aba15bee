# SPDX-License-Identifier: Apache-2.0
"""Tuning of the gaits of a campaign, each recorded run of which is a bag of its own."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from functools import cache
from pathlib import Path

from worm_model.gait import Gait
from worm_optimizer.operation.bring_up import CYCLES, Say
from worm_optimizer.operation.campaign_runs import Prepare, gait_recorder, is_recorded
from worm_optimizer.operation.system import Robot
from worm_optimizer.operation.tuning_runs import Measure, Tuned, tune_gait
from worm_optimizer.robot_commands import GaitCommand

TUNING = "tuning"  # folder of the bags


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
