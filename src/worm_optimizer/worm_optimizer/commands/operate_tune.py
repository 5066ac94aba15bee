# SPDX-License-Identifier: Apache-2.0
"""The action `operate tune`: runs of a gait and its successors until the measured margin suffices."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from worm_model.commands.command_line import FAILED, print_result
from worm_msgs.gait import Gait
from worm_optimizer.commands.operate_run import attended, conditions_of, own_gait, requested
from worm_optimizer.commands.tune import Aim, described, measured_step, tuned_json
from worm_optimizer.nodes.operator_node import DRIVER, GaitFailedError, OperatorNode
from worm_optimizer.operation.bring_up import CYCLES, ProgressLog, new_bag, recorded
from worm_optimizer.operation.campaign_runs import Tuned, require_tracker, tune_gait
from worm_optimizer.robot_commands import GaitCommand
from worm_optimizer.robustness.tuning import GaitLimits, TuneState, Tuning

_LIMITS = ("limits.max_stroke_m", "limits.max_cable_speed_m_per_s")
_ROUNDING = 1e-4  # of a stroke, m


def tune(node: OperatorNode, options: argparse.Namespace) -> int:
    """Tune the gait of the options on the robot, and print the last step."""
    say = ProgressLog("operate")
    require_tracker(node)
    conditions = conditions_of(node, options, say)
    gait, aim = _first(node, options, say)

    def record(gait: Gait, number: int) -> Path:
        name = f"{os.getpid()}_{number}"
        bag = new_bag(options.record, "tune")
        with recorded(node, bag, options.parameters, conditions, name) as path:
            result = attended(node, GaitCommand(gait, CYCLES), say)
        if not result.success:
            raise GaitFailedError(f"run {number}: {result.message}")
        return path

    def measure(bags: Sequence[Path]) -> Tuning:
        return measured_step(bags, aim, say)

    return _print(options, tune_gait(gait, record, measure, say))


def _first(node: OperatorNode, options: argparse.Namespace, say: ProgressLog) -> tuple[Gait, Aim]:
    """Return the first gait and the aim. A requested gait is to keep the grooves that the optimizer predicts."""
    aim = Aim(options.probability, options.grooves, _limits(node), options.parameters)
    own = own_gait(options)
    if own is not None:
        return own, aim
    answer = requested(node, options, say)
    return answer.gait, replace(aim, grooves=aim.grooves or round(answer.grooves_per_cycle))


def _limits(node: OperatorNode) -> GaitLimits:
    """Return the limits of the driver, less the rounding of a tuned gait."""
    reach, speed = node.numbers(DRIVER, _LIMITS)
    return GaitLimits(
        lambda gait: min(reach - gait.pretension, speed * gait.stroke / gait.peak_speed) - _ROUNDING
    )


def _print(options: argparse.Namespace, tuned: Tuned) -> int:
    step = tuned.step
    print_result(options, tuned_json(tuned), "\n".join([*map(str, tuned.bags), described(step)]))
    if step.state is TuneState.DONE:
        return 0
    if step.state is TuneState.RUN:
        text = f"not done after {len(tuned.bags)} runs; continue with the gait that is printed"
        print(f"operate: {text}", file=sys.stderr)  # noqa: T201
    else:
        print(f"operate: impossible: {step.reason}", file=sys.stderr)  # noqa: T201
    return FAILED
