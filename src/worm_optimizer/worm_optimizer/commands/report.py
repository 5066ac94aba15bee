# SPDX-License-Identifier: Apache-2.0
"""Command line: a report of recorded gaits, one HTML page with its figures beside it."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from worm_model.commands.command_line import InputError, Parser, add_parameters, print_json
from worm_optimizer.commands import arguments
from worm_optimizer.report.build import Report, build_report
from worm_optimizer.report.choice import bags_of, newest_recording
from worm_optimizer.report.identification_part import add_identification, identification_of
from worm_optimizer.report.optimisation import Optimisation, optimise, why_no_front
from worm_optimizer.report.reading import read_recorded_gaits
from worm_optimizer.report.recorded import RecordedGait
from worm_optimizer.report.text import describe
from worm_optimizer.report.verdict import agreements, orders, title_of
from worm_optimizer.search.cache import Cache, default_directory

_BAGS = Path("bags")


def main() -> int:
    """Entry point of the executable report."""
    return arguments.run(_parser(), _report)


def _parser() -> Parser:
    parser = Parser(
        prog="report",
        description="What ran, measured against predicted, events, residuals and provenance of recorded gaits, with "
        "the robust front and the price of robustness: one HTML page that needs nothing else, and each figure as PNG "
        "and PDF.",
    )
    add = parser.add_argument
    add(
        "bags",
        nargs="*",
        type=Path,
        metavar="BAG",
        help="or a folder of bags, such as a campaign's; default: what was recorded last in bags/",
    )
    add("--output", type=Path, metavar="FOLDER", help="a new folder (default: BAG_report)")
    add("--title", default="", help="of the page")
    add("--without-front", action="store_true", help="leave the optimizer's part out")
    add("--json", action="store_true", help="print one JSON object")
    add_identification(parser)
    add_parameters(parser)
    return parser


def _report(options: argparse.Namespace) -> None:
    named = options.bags or [newest_recording(_BAGS, notify)]
    folder = options.output or _beside(named[0])
    if folder.exists():
        raise InputError(f"{folder}: exists already; give another name with --output")
    identification = identification_of(options)
    gaits = read_gaits([bag for path in named for bag in bags_of(path)], options.parameters)
    note = "" if options.without_front else why_no_front(gaits)
    optimisation = None
    if note:
        notify(note)
    elif not options.without_front:
        optimisation = _optimised(gaits)
    title = options.title or f"Worm robot: {', '.join(title_of(gait.name) for gait in gaits)}"
    page = build_report(Report(title, gaits, optimisation, note, identification), folder)
    if options.json:
        print_json({"page": str(page), **report_json(gaits)})
    else:
        arguments.say(f"{describe(gaits)}\n\nreport  {page}")


def _beside(path: Path) -> Path:
    name = path.stem if path.is_file() else path.resolve().name
    return path.resolve().parent / f"{name}_report"


def read_gaits(bags: Sequence[Path], parameters: str) -> list[RecordedGait]:
    """All gaits of some bags; as `read_recorded_gaits`, which says on standard error what it has to say."""
    return read_recorded_gaits(bags, parameters, notify)


def _optimised(gaits: Sequence[RecordedGait]) -> Optimisation:
    progress = arguments.shown_progress("front")
    return optimise(gaits, Cache.at(default_directory()), progress)


def report_json(gaits: Sequence[RecordedGait]) -> dict[str, Any]:
    """Measured against expected as the machine-readable output has it."""
    return {
        "runs": [
            {
                "name": gait.name,
                "gait": asdict(gait.gait),
                "measured": asdict(gait.measured),
                "expected": asdict(gait.expected.bands),
                "twin": asdict(gait.twin),
                "groove_phase": gait.expected.nominal.groove_phase,
                "agrees": {row.quantity: row.agrees for row in agreements(gait)},
                "missing": list(gait.missing),
            }
            for gait in gaits
        ],
        "order_preserved": {order.quantity: order.preserved for order in orders(gaits)},
    }


def notify(line: str) -> None:
    """Tells on standard error."""
    sys.stderr.write(f"report: {line}\n")
