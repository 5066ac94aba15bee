# SPDX-License-Identifier: Apache-2.0
"""Command line: a certified robust front, its three gaits, and what nominal ones would be worth."""

from __future__ import annotations

import argparse
import math
from dataclasses import asdict
from typing import Any

from worm_model.commands.command_line import Parser, print_json
from worm_model.parameters import load_parameter_file
from worm_optimizer.commands import arguments
from worm_optimizer.report.front_plots import draw_front_and_map
from worm_optimizer.robustness import fragility
from worm_optimizer.robustness.prediction import Prediction
from worm_optimizer.robustness.uncertainty import told
from worm_optimizer.search.actuator_limits import ActuatorLimits
from worm_optimizer.search.front import make_front, task_of
from worm_optimizer.search.selection import three_gaits
from worm_optimizer.search.served import ServedFront


def _parser() -> Parser:
    parser = Parser(
        prog="optimize",
        description="NSGA-II over stroke and frequency for speed and power at a robustness margin, "
        "certified by an exhaustive map; prints the minimum-power, cruising and maximum-speed gaits "
        "beside those without a margin.",
    )
    arguments.add_common(parser)
    arguments.add_search(parser)
    return parser


def front_json(front: ServedFront, nominal: dict[str, Prediction]) -> dict[str, Any]:
    """A front as the machine-readable output has it; ``nominal`` are the gaits without a margin."""
    return {
        "front": [arguments.gait_json(gait) for gait in front.predictions],
        "hypervolume_share": front.hypervolume_share,
        "missed_branches": list(front.missed_branches),
        "served": front.source,
        "direction": front.direction,
        "margin": front.margin,
        "margin_reason": front.reason,
        **{
            name: arguments.gait_json(gait) for name, gait in three_gaits(front.predictions).items()
        },
        "nominal": {name: arguments.gait_json(gait) for name, gait in nominal.items()},
    }


def describe(
    front: ServedFront, nominal: dict[str, Prediction], uncertainty: str, limits: ActuatorLimits
) -> str:
    """A front for people."""
    three = three_gaits(front.predictions)
    missed = ", ".join(map(str, front.missed_branches)) or "none"
    return "\n".join(
        [
            f"margin             {1e3 * front.margin:.2f} mm: {front.reason}",
            f"groove phase       {1e3 * three['cruise'].groove_phase:+.2f} mm; every speed holds for it",
            f"hypervolume share  {100.0 * front.hypervolume_share:.2f} % of the true front's; "
            f"branches missed: {missed}; serves the {front.source} front of {len(front.predictions)} gaits",
            f"limits             {limits.told() or 'none'}",
            "",
            fragility.table(three, nominal),
            "",
            f"success: share of draws of the parameters ({uncertainty}) in which the robot, without a "
            "margin, gains the predicted grooves in every averaged cycle; any φ: at an unknown phase",
        ]
    )


def _optimize(options: argparse.Namespace) -> None:
    content = load_parameter_file(options.parameters)
    settings = arguments.front_settings(options)
    cache, figure = arguments.cache_of(options), arguments.figure_file(options)
    report = arguments.shown_progress("optimizing")
    front = make_front(content, settings, options.direction, cache, report)
    nominal = fragility.nominal_gaits(content, settings, options.direction)
    if figure is not None:
        task = task_of(content, settings, options.direction).with_margin(front.margin)
        draw_front_and_map(front, task, three_gaits(front.predictions), figure)
    if options.json:
        limits = {
            name: value for name, value in asdict(settings.limits).items() if math.isfinite(value)
        }
        told_too = {"uncertainty": told(content), "limits": limits}
        print_json({**front_json(front, nominal), **told_too})
    else:
        arguments.say(describe(front, nominal, told(content), settings.limits))


def main() -> int:
    """Entry point of the executable optimize."""
    return arguments.run(_parser(), _optimize)
