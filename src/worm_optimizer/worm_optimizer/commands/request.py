# SPDX-License-Identifier: Apache-2.0
"""Command line: gait for an objective, exactly on the edges of the branches, computed without any node."""

from __future__ import annotations

import argparse
from dataclasses import asdict

from worm_model.commands.command_line import (
    Parser,
    elapsed,
    executable,
    figure_file,
    number,
    print_result,
)
from worm_model.errors import InputError
from worm_model.parameters import load_parameter_file
from worm_optimizer.commands.search_options import (
    add_front_options,
    chosen_settings,
    gait_table,
    shape_lines,
    success_lines,
)
from worm_optimizer.gait_prediction import Prediction
from worm_optimizer.search.gait_request import GaitRequest, Objective, RequestStatus, select


def _parser() -> Parser:
    parser = Parser(
        prog="request",
        description="Print one gait of the exact robust front: with the lowest power, the lowest cost of transport, "
        "the highest speed, the lowest power at a speed or the highest speed at a power. If no gait reaches the speed, "
        "or all need more than the power, print the nearest gait and exit with status 2.",
    )
    add_objective(parser)
    add_front_options(parser)
    return parser


_NAMED = {
    objective.name.lower(): objective
    for objective in (Objective.MIN_POWER, Objective.CRUISE, Objective.MAX_SPEED)
}


def add_objective(parser: Parser) -> None:
    """Add the options of a requested gait; see `request_of_options`."""
    group = parser.add_mutually_exclusive_group()
    group.add_argument("--objective", choices=tuple(_NAMED), help="default cruise")
    group.add_argument(
        "--speed",
        type=number,
        metavar="MPS",
        help="request the gait with the lowest power at this speed (m/s) or faster",
    )
    group.add_argument(
        "--power",
        type=number,
        metavar="W",
        help="request the fastest gait at this power (W) or less",
    )


def request_of_options(options: argparse.Namespace) -> GaitRequest:
    """Return the request that the options of `add_objective` describe. Raises `InputError` for a bad value."""
    if options.speed is not None:
        return GaitRequest(Objective.MIN_POWER_AT_SPEED, options.speed)
    if options.power is not None:
        return GaitRequest(Objective.MAX_SPEED_AT_POWER, options.power)
    return GaitRequest(_NAMED[options.objective or "cruise"])


def describe(gait: Prediction, uncertainty: str, warning: str) -> str:
    """Return a gait as text, with the groove phase for which its speed holds, and what its probabilities mean."""
    phase = f"groove phase {1e3 * gait.groove_phase:+.2f} mm; the speed holds for this phase"
    lines = [gait_table({"gait": gait}, {}), *shape_lines({"gait": gait}), phase]
    return "\n".join([*lines, success_lines(uncertainty, warning)])


def _request(options: argparse.Namespace) -> None:
    from worm_optimizer.robustness.uncertainty import description  # here: Numba loads slowly
    from worm_optimizer.search.front import make_front

    content = load_parameter_file(options.parameters)
    settings, request = chosen_settings(options), request_of_options(options)
    figure = figure_file(options)
    with elapsed("front"):
        front = make_front(content, settings, options.direction)
        answer = select(front, request)
    gait = answer.prediction
    assert gait is not None
    uncertainty, warning = description(content), front.warning([gait])
    text = describe(gait, uncertainty, warning)
    unreachable = answer.status is not RequestStatus.DONE
    if figure is not None:
        from worm_model.analysis.plot_style import save_figure  # here: matplotlib loads slowly
        from worm_optimizer.report.front_plots import front_figure

        save_figure(front_figure(front, {"nearest" if unreachable else "gait": gait}), figure)
    if unreachable:
        rejection = {"error": answer.message, "nearest": asdict(gait)}
        print_result(options, rejection, f"the nearest gait:\n{text}")
        raise InputError(answer.message)
    figures = {**asdict(gait), "uncertainty": uncertainty, "warning": warning}
    print_result(options, figures, text)


main = executable(_parser, _request)
