# SPDX-License-Identifier: Apache-2.0
"""Command line: what is done with bags as a whole, a verb each."""

from __future__ import annotations

import argparse
from pathlib import Path

from worm_model.bags.cleaning import clean_bag
from worm_model.bags.opening import open_bag
from worm_model.commands.command_line import (
    Parser,
    new_file,
    notifier,
    print_result,
    run_command,
)


def _parser() -> Parser:
    parser = Parser(prog="bags", description="What is done with bags as a whole.")
    verbs = parser.add_subparsers(dest="verb", required=True, metavar="VERB", parser_class=Parser)
    clean = verbs.add_parser(
        "clean",
        help="a copy without the host's name and absolute paths",
        description="Writes a copy of a bag without what tells where it was recorded: the host's name, and of every "
        "absolute path (command line, parameter file, devices; in metadata, attachments and texts of messages) "
        "all but its last part. Names of the robot's topics stay.",
    )
    clean.add_argument("bag", type=Path, metavar="BAG")
    clean.add_argument("--output", required=True, metavar="BAG2", help="must not exist")
    clean.add_definitions()
    clean.add_json()
    clean.set_defaults(act=_clean)
    return parser


def _clean(options: argparse.Namespace) -> None:
    output = new_file(options.output)
    with open_bag(options.bag, notifier("bags clean"), options.definitions) as bag:
        count = bag.message_count
        cleaner = clean_bag(bag, output)
    content = {"bag": str(output), "messages": count, "changed": cleaner.changed}
    text = f"{output}: {count} messages, in {cleaner.changed} of them texts changed"
    print_result(options, content, text)


def main() -> int:
    """Entry point of the executable bags."""
    return run_command(_parser(), lambda options: options.act(options))
