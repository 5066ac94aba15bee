# SPDX-License-Identifier: Apache-2.0
"""Command line: report on recorded gaits, as an HTML page with figures."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from worm_model.commands.command_line import InputError, Parser, executable, notifier, print_result
from worm_optimizer.report.agreement import agreement_json, describe, title_of
from worm_optimizer.report.identification_parts import add_identification, identification_of
from worm_optimizer.report.optimisation import optimise, why_no_front
from worm_optimizer.report.recordings import bags_of, newest_recording, read_recorded_gaits
from worm_optimizer.report.report_page import Report, build_report, report_name

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


def _report(options: argparse.Namespace) -> None:
    named = options.bags or [newest_recording(_BAGS, _notify)]
    folder = options.output or _default_folder(named)
    if folder.exists():
        raise InputError(f"{folder}: exists already; give another name with --output")
    identification = identification_of(options)
    bags = [bag for path in named for bag in bags_of(path)]
    gaits = read_recorded_gaits(bags, options.parameters, _notify)
    note = "" if options.without_front else why_no_front(gaits)
    optimisation = None
    if note:
        _notify(note)
    elif not options.without_front:
        optimisation = optimise(gaits)
    title = options.title or f"Worm robot: {', '.join(title_of(gait.name) for gait in gaits)}"
    page = build_report(Report(title, gaits, optimisation, note, identification), folder)
    content = {"page": str(page), **agreement_json(gaits)}
    print_result(options, content, f"{describe(gaits)}\n\nreport  {page}")


def _default_folder(paths: Sequence[Path]) -> Path:
    names = [path.stem if path.is_file() else path.resolve().name for path in paths]
    return paths[0].resolve().parent / report_name(names)


main = executable(_parser, _report)
