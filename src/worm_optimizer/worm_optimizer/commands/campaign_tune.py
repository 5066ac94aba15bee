# SPDX-License-Identifier: Apache-2.0
"""The option --tune of the command `campaign`: its three gaits are tuned on the robot before they are validated."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

from worm_model.gait import Gait
from worm_model.parameters import load_parameter_file
from worm_optimizer.commands.search_options import chosen_settings
from worm_optimizer.commands.tune import Aim, measured_step, tuned_json
from worm_optimizer.commands.tuning_options import PROBABILITY
from worm_optimizer.gait_prediction import Prediction
from worm_optimizer.operation.bring_up import ProgressLog
from worm_optimizer.operation.campaign_plan import Plan
from worm_optimizer.operation.campaign_runs import Prepare
from worm_optimizer.operation.system import Robot
from worm_optimizer.operation.tuning_runs import Measure, tune_gaits
from worm_optimizer.robustness.tuning import limits_of
from worm_optimizer.search.front import predicted_gaits, task_of
from worm_optimizer.search.search_settings import Settings


def settings_of_campaign(options: argparse.Namespace, robot: Robot) -> Settings:
    """Return the settings of the options, under the robot's conditions."""
    return replace(chosen_settings(options), conditions=robot.conditions)


def tuned_plan(
    options: argparse.Namespace,
    robot: Robot,
    plan: Plan,
    folders: tuple[Path, Path],
    say: ProgressLog,
    ask: Prepare,
) -> tuple[Plan, dict[str, Any]]:
    """Tune the three gaits of a plan on the robot.

    Return a plan with the tuned gaits and their predictions, and the tuning of each gait as a JSON object.

    Args:
        options: options of the campaign.
        robot: the robot.
        plan: the plan.
        folders: folder of the campaign, and temporary folder with the log files.
        say: called with each line of progress.
        ask: called before each run; raises an exception to end the campaign.
    """
    folder, work = folders
    content = load_parameter_file(options.parameters)
    settings = settings_of_campaign(options, robot)
    limits = limits_of(task_of(content, settings, options.direction))

    def first(gait: Prediction) -> tuple[Gait, Measure]:
        grooves = round(gait.grooves_per_cycle)
        aim = Aim(options.probability or PROBABILITY, grooves, limits, options.parameters)
        return gait.gait, lambda bags: measured_step(bags, aim, say)

    three = {name: first(gait) for name, gait in plan.optimisation.front.three.items()}
    logs = work / "logs" / "tuning"
    logs.mkdir()
    tuned = tune_gaits(robot, three, folder, logs, say, ask)
    gaits = predicted_gaits(
        {name: each.step.gait for name, each in tuned.items()}, content, settings
    )
    tuning = {name: tuned_json(each) for name, each in tuned.items()}
    return replace(plan, gaits={**plan.gaits, **gaits}), tuning
