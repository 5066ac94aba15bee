# SPDX-License-Identifier: Apache-2.0
"""Options of a requested gait, for the commands `request` and `operate`."""

from __future__ import annotations

import argparse

from worm_model.commands.command_line import Parser, number
from worm_optimizer.search.gait_request import GaitRequest, Objective

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
    """Return the request that the options of `add_objective` describe. Raises `OptimizerError` for a bad value."""
    if options.speed is not None:
        return GaitRequest(Objective.MIN_POWER_AT_SPEED, options.speed)
    if options.power is not None:
        return GaitRequest(Objective.MAX_SPEED_AT_POWER, options.power)
    return GaitRequest(_NAMED[options.objective or "cruise"])
