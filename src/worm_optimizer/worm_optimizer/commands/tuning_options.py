# SPDX-License-Identifier: Apache-2.0
"""Options of a tuning, for the commands `tune` and `operate tune`."""

from __future__ import annotations

import argparse

from worm_model.commands.command_line import InputError, Parser, number
from worm_model.commands.margin import add_grooves, check_grooves

PROBABILITY = 0.99  # default


def add_aim(parser: Parser) -> None:
    """Add the probability and the grooves that a tuning is to reach."""
    parser.add_argument(
        "--probability",
        type=number,
        default=PROBABILITY,
        metavar="P",
        help=f"probability that a cycle keeps its grooves (default: {PROBABILITY})",
    )
    add_grooves(
        parser,
        "the most in any cycle of the runs but their first; of a requested gait, the predicted ones",
    )


def check_aim(options: argparse.Namespace) -> None:
    """Raise `InputError` if the options of `add_aim` are inadmissible."""
    if not 0.0 < options.probability < 1.0:
        raise InputError(f"--probability {options.probability:g}: give a number between 0 and 1")
    check_grooves(options)
