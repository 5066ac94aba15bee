# SPDX-License-Identifier: Apache-2.0
"""Command line: makes a whole bag of one that was not closed."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from pathlib import Path

from worm_model.bags.recovery import recover
from worm_model.commands.command_line import Parser, executable, new_file, print_result


def _parser() -> Parser:
    parser = Parser(
        prog="recover",
        description="Writes what is intact of a bag into a new one, metadata.yaml included. The old "
        "one is left as it is.",
    )
    parser.add_argument("bag", type=Path, metavar="BAG", help="bag directory, or an MCAP file")
    parser.add_argument("--output", metavar="BAG2", help="the new bag (default: BAG_recovered)")
    parser.add_json()
    return parser


def _recover(options: argparse.Namespace) -> None:
    report = recover(options.bag, new_file(options.output) if options.output else None)
    content = asdict(report) | {
        "bag": str(report.bag),
        "damaged_chunks": len(report.lost),
        "undeclared": dict(report.undeclared),
    }
    print_result(options, content, str(report))


main = executable(_parser, _recover)
