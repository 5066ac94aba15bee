# SPDX-License-Identifier: Apache-2.0
"""Command line: report on recorded gaits, as an HTML page with figures.

The functions import what they use, because these imports take seconds, and --help needs none of them.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from worm_model.commands.command_line import (
    InputError,
    Parser,
    elapsed,
    executable,
    notifier,
    print_result,
)
from worm_model.parameters import load_parameter_file

_BAGS = Path("bags")
_notify = notifier("report")


def _parser() -> Parser:
    parser = Parser(
        prog="report",
        description="Write a report on recorded gaits: measurements and predictions, events, residuals, provenance, "
        "the robust front and the price of robustness. It is one self-contained HTML page; the figures are also "
        "written as PNG and PDF.",
    )
    add = parser.add_argument
    add(
        "bags",
        nargs="*",
        type=Path,
        metavar="BAG",
        help="bag, or folder of bags such as that of a campaign; default: the newest recording in bags/",
    )
    add(
        "--output",
        type=Path,
        metavar="FOLDER",
        help="new folder (default: BAG_report; for two bags BAG_with_BAG_report, for three BAG_with_2_others_report)",
    )
    add("--title", default="", help="title of the page")
    add("--without-front", action="store_true", help="omit the front and the price of robustness")
    add_identification(parser)
    parser.add_json()
    parser.add_parameters("the file in each bag, else the paper's values")
    return parser


def add_identification(parser: Parser) -> None:
    """Add the option that names identified parameters."""
    parser.add_argument(
        "--identification",
        default="",
        metavar="FILE",
        help="parameter file that identify has written, for a table with the paper's values",
    )


def _report(options: argparse.Namespace) -> None:
    from worm_optimizer.report import agreement, optimisation, recordings, report_page

    named = options.bags or [recordings.newest_recording(_BAGS, _notify)]
    folder = options.output or _default_folder(named)
    if folder.exists():
        raise InputError(f"{folder}: exists already; give another name with --output")
    load_parameter_file(options.identification)
    bags = [bag for path in named for bag in recordings.bags_of(path)]
    with elapsed("gaits"):
        gaits = recordings.read_recorded_gaits(bags, options.parameters, _notify)
    note = "" if options.without_front else optimisation.why_no_front(gaits)
    found = None
    if note:
        _notify(note)
    elif not options.without_front:
        with elapsed("front"):
            found = optimisation.optimise(gaits)
    title = (
        options.title or f"Worm robot: {', '.join(agreement.title_of(gait.name) for gait in gaits)}"
    )
    content = report_page.Report(title, gaits, found, note, options.identification)
    with elapsed("page"):
        page = report_page.build_report(content, folder)
    result = {"page": str(page), **agreement.agreement_json(gaits)}
    print_result(options, result, f"{agreement.describe(gaits)}\n\nreport  {page}")


def _default_folder(paths: Sequence[Path]) -> Path:
    from worm_optimizer.report.report_page import report_name

    names = [path.stem if path.is_file() else path.resolve().name for path in paths]
    return paths[0].resolve().parent / report_name(names)


main = executable(_parser, _report)
