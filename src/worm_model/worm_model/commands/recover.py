# SPDX-License-Identifier: Apache-2.0
"""Command line: copy of all that can be read of a bag that was not closed or is damaged."""

from __future__ import annotations

import argparse
from pathlib import Path

from worm_model.bags.operations.copies import recover
from worm_model.commands.command_line import Parser, executable, new_file, print_result


def _parser() -> Parser:
    parser = Parser(
        prog="recover",
        description="Write all readable messages of a bag to a new bag. The old bag is not changed.",
    )
    parser.add_argument(
        "bag", type=Path, metavar="BAG", help="bag directory, or a file *.mcap or *.db3"
    )
    parser.add_argument("--output", metavar="BAG2", help="the new bag (default: BAG_recovered)")
    parser.add_json()
    return parser


def _recover(options: argparse.Namespace) -> None:
    output = new_file(options.output) if options.output else None
    bag, count, loss = recover(options.bag, output)
    text = f"{bag}: {count} messages" + (f"; {loss}" if loss else "")
    print_result(options, {"bag": str(bag), "messages": count, "loss": loss}, text)


main = executable(_parser, _recover)
