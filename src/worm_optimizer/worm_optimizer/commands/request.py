# SPDX-License-Identifier: Apache-2.0
"""Command line: a gait for a purpose, from the front that these settings make; needs no node."""

from __future__ import annotations

import argparse
from dataclasses import asdict

from worm_model.analysis.plot_style import save_figure
from worm_model.commands.command_line import (
    InputError,
    Parser,
    figure_file,
    print_result,
    run_command,
)
from worm_model.parameters import load_parameter_file
from worm_optimizer.commands.search_options import (
    add_front_options,
    add_objective,
    cache_of,
    chosen_settings,
    gait_table,
    request_of_options,
    shown_progress,
)
from worm_optimizer.report.front_plots import front_figure
from worm_optimizer.robustness.prediction import Prediction
from worm_optimizer.search.front import load_front, make_front
from worm_optimizer.search.gait_request import RequestStatus, select


def _parser() -> Parser:
    parser = Parser(
        prog="request",
        description="One gait of the robust front: for the lowest power, the lowest cost of transport, "
        "the highest speed, the lowest power at a speed or the highest speed at a power. The front is "
        "computed if it is not in the cache. Where no gait is fast or frugal enough, it names the nearest one and "
        "ends with status 2.",
    )
    add_objective(parser)
    add_front_options(parser)
    return parser


def describe(gait: Prediction) -> str:
    """A gait for people; the groove phase always stands beside the speed, which holds for it alone."""
    phase = f"groove phase {1e3 * gait.groove_phase:+.2f} mm; the speed holds for it"
    return f"{gait_table({'gait': gait}, {})}\n{phase}"


def _request(options: argparse.Namespace) -> None:
    content = load_parameter_file(options.parameters)
    settings, request = chosen_settings(options), request_of_options(options)
    cache, figure = cache_of(options), figure_file(options)
    front = load_front(content, settings, options.direction, cache)
    if front is None:
        progress = shown_progress("optimizing")
        front = make_front(content, settings, options.direction, cache, progress)
    answer = select(front.predictions, request)
    gait = answer.prediction
    assert gait is not None
    unreachable = answer.status is not RequestStatus.DONE
    if figure is not None:
        save_figure(front_figure(front, {"nearest" if unreachable else "gait": gait}), figure)
    if unreachable:
        refusal = {"error": answer.message, "nearest": asdict(gait)}
        print_result(options, refusal, f"the nearest that is there:\n{describe(gait)}")
        raise InputError(answer.message)
    print_result(options, asdict(gait), describe(gait))


def main() -> int:
    """Entry point of the executable request."""
    return run_command(_parser(), _request)
