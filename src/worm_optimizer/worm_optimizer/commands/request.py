# SPDX-License-Identifier: Apache-2.0
"""Command line: a gait for a purpose, from the front that these settings make; needs no node."""

from __future__ import annotations

import argparse

from worm_model.commands.command_line import InputError, Parser, number, print_json
from worm_model.parameters import load_parameter_file
from worm_optimizer.commands import arguments
from worm_optimizer.report.front_plots import draw_front
from worm_optimizer.robustness import fragility
from worm_optimizer.robustness.prediction import Prediction
from worm_optimizer.search.front import load_front, make_front
from worm_optimizer.search.selection import Objective, Request, select

_NAMED = {
    "min_power": Objective.MIN_POWER,
    "cruise": Objective.CRUISE,
    "max_speed": Objective.MAX_SPEED,
}


def _parser() -> Parser:
    parser = Parser(
        prog="request",
        description="One gait of the robust front: for the lowest power, the lowest cost of transport, "
        "the highest speed, the lowest power at a speed or the highest speed at a power. The front is "
        "computed if it is not in the cache. Exit status 2 with the nearest gait if there is none.",
    )
    wanted = parser.add_mutually_exclusive_group()
    wanted.add_argument("--objective", choices=tuple(_NAMED), help="default cruise")
    wanted.add_argument(
        "--speed", type=number, metavar="MPS", help="lowest power of those at least as fast, in m/s"
    )
    wanted.add_argument(
        "--power", type=number, metavar="W", help="highest speed of those that need no more, in W"
    )
    arguments.add_common(parser)
    arguments.add_search(parser)
    return parser


def _request_of(options: argparse.Namespace) -> Request:
    if options.speed is not None:
        return Request(Objective.MIN_POWER_AT_SPEED, options.speed)
    if options.power is not None:
        return Request(Objective.MAX_SPEED_AT_POWER, options.power)
    return Request(_NAMED[options.objective or "cruise"])


def describe(gait: Prediction) -> str:
    """A gait for people; the groove phase always stands beside the speed, which holds for it alone."""
    phase = f"groove phase {1e3 * gait.groove_phase:+.2f} mm; the speed holds for it"
    return f"{fragility.table({'gait': gait}, {})}\n{phase}"


def _request(options: argparse.Namespace) -> None:
    content = load_parameter_file(options.parameters)
    settings, request = arguments.front_settings(options), _request_of(options)
    cache, figure = arguments.cache_of(options), arguments.figure_file(options)
    front = load_front(content, settings, options.direction, cache)
    if front is None:
        report = arguments.shown_progress("optimizing")
        front = make_front(content, settings, options.direction, cache, report)
    choice = select(front.predictions, request)
    if figure is not None:
        draw_front(front, {"nearest" if choice.refusal else "gait": choice.prediction}, figure)
    if choice.refusal:
        if options.json:
            print_json({"error": choice.refusal, "nearest": arguments.gait_json(choice.prediction)})
        raise InputError(choice.refusal)
    if options.json:
        print_json(arguments.gait_json(choice.prediction))
    else:
        arguments.say(describe(choice.prediction))


def main() -> int:
    """Entry point of the executable request."""
    return arguments.run(_parser(), _request)
