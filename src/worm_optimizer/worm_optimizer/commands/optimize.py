# SPDX-License-Identifier: Apache-2.0
"""Command line: a certified robust front, its three gaits, and what nominal ones would be worth."""

from __future__ import annotations

import argparse
import math
from dataclasses import asdict
from typing import Any

from worm_model.analysis.plot_style import save_figure
from worm_model.commands.command_line import Parser, figure_file, print_result, run_command
from worm_model.parameters import load_parameter_file
from worm_optimizer.commands.search_options import (
    add_front_options,
    cache_of,
    chosen_settings,
    gait_table,
    shown_progress,
)
from worm_optimizer.report.front_plots import front_and_map_figure
from worm_optimizer.robustness.prediction import Prediction
from worm_optimizer.robustness.uncertainty import description
from worm_optimizer.search.actuator_limits import ActuatorLimits
from worm_optimizer.search.front import RobustFront, make_front, nominal_gaits, task_of
from worm_optimizer.search.gait_request import three_gaits


def _parser() -> Parser:
    parser = Parser(
        prog="optimize",
        description="NSGA-II over stroke and frequency for speed and power at a robustness margin, "
        "certified by an exhaustive map; prints the minimum-power, cruising and maximum-speed gaits "
        "beside those without a margin.",
    )
    add_front_options(parser)
    return parser


def front_json(front: RobustFront, nominal: dict[str, Prediction]) -> dict[str, Any]:
    """A front as the machine-readable output has it; ``nominal`` are the gaits without a margin."""
    return {
        "front": [asdict(gait) for gait in front.predictions],
        "hypervolume_share": front.hypervolume_share,
        "missed_branches": list(front.missed_branches),
        "source": front.source,
        "direction": front.direction,
        "margin": front.margin,
        "margin_reason": front.reason,
        **{name: asdict(gait) for name, gait in three_gaits(front.predictions).items()},
        "nominal": {name: asdict(gait) for name, gait in nominal.items()},
    }


def describe(
    front: RobustFront, nominal: dict[str, Prediction], uncertainty: str, limits: ActuatorLimits
) -> str:
    """A front for people."""
    three = three_gaits(front.predictions)
    missed = ", ".join(map(str, front.missed_branches)) or "none"
    return "\n".join(
        [
            f"margin             {1e3 * front.margin:.2f} mm: {front.reason}",
            f"groove phase       {1e3 * three['cruise'].groove_phase:+.2f} mm; every speed holds for it",
            f"hypervolume share  {100.0 * front.hypervolume_share:.2f} % of the true front's; "
            f"branches missed: {missed}",
            f"front              {len(front.predictions)} gaits, source {front.source}",
            f"limits             {limits.description() or 'none'}",
            "",
            gait_table(three, nominal),
            "",
            f"success: share of draws of the parameters ({uncertainty}) in which the robot, without a "
            "margin, gains the predicted grooves in every averaged cycle; any φ: at an unknown phase",
        ]
    )


def _optimize(options: argparse.Namespace) -> None:
    content = load_parameter_file(options.parameters)
    settings, cache, figure = chosen_settings(options), cache_of(options), figure_file(options)
    front = make_front(content, settings, options.direction, cache, shown_progress("optimizing"))
    nominal = nominal_gaits(content, settings, options.direction)
    if figure is not None:
        task = task_of(content, settings, options.direction).with_margin(front.margin)
        save_figure(front_and_map_figure(front, task, three_gaits(front.predictions)), figure)
    limits = {
        name: value for name, value in asdict(settings.limits).items() if math.isfinite(value)
    }
    uncertainty = description(content)
    print_result(
        options,
        {**front_json(front, nominal), "uncertainty": uncertainty, "limits": limits},
        describe(front, nominal, uncertainty, settings.limits),
    )


def main() -> int:
    """Entry point of the executable optimize."""
    return run_command(_parser(), _optimize)
