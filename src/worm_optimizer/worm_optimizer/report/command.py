# SPDX-License-Identifier: Apache-2.0
"""Command line: a report of recorded gaits, one HTML page with its figures beside it."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from worm_model.bags.bag import METADATA_FILE
from worm_model.command_line import InputError, Parser, add_parameters, print_json
from worm_model.parameters import ParameterFile, load_parameter_file
from worm_optimizer import arguments
from worm_optimizer.cache import Cache, default_directory
from worm_optimizer.pipeline import load_front, make_front, scanned_price
from worm_optimizer.report.build import Identification, Optimisation, Report, build_report
from worm_optimizer.report.recorded import RecordedGait, read_recorded_gait
from worm_optimizer.report.text import describe
from worm_optimizer.report.verdict import agreements, orders
from worm_optimizer.settings import Settings

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
        help="or a folder of bags; default: the newest one in bags/",
    )
    add("--output", type=Path, metavar="FOLDER", help="a new folder (default: BAG_report)")
    add("--title", default="", help="of the page")
    add("--without-front", action="store_true", help="leave the optimizer's part out")
    add("--identification", metavar="FILE", help="a parameter file that identify has written")
    add("--json", action="store_true", help="print one JSON object")
    add_parameters(parser)
    return parser


def _report(options: argparse.Namespace) -> None:
    named = options.bags or [newest_bag(_BAGS)]
    folder = options.output or _beside(named[0])
    if folder.exists():
        raise InputError(f"{folder}: exists already; give another name with --output")
    identification = None
    if options.identification:
        content = load_parameter_file(options.identification)
        identification = Identification(content, options.identification)
    bags = [bag for path in named for bag in bags_of(path)]
    gaits = [read_recorded_gait(bag, options.parameters, notify) for bag in bags]
    optimisation = (
        None if options.without_front else optimise(gaits[0].content, gaits[0].gait.direction)
    )
    title = options.title or f"Worm robot: {', '.join(gait.name for gait in gaits)}"
    page = build_report(Report(title, gaits, optimisation, identification), folder)
    if options.json:
        print_json({"page": str(page), **report_json(gaits)})
    else:
        arguments.say(f"{describe(gaits)}\n\nreport  {page}")


def _beside(path: Path) -> Path:
    name = path.stem if path.is_file() else path.resolve().name
    return path.resolve().parent / f"{name}_report"


def bags_of(path: Path) -> list[Path]:
    """A bag itself; of a folder of bags, such as a campaign's, all of them in the order in which they were closed."""
    inside = [] if (path / METADATA_FILE).exists() else list(path.glob(f"*/{METADATA_FILE}"))
    closed = sorted(inside, key=lambda file: file.stat().st_mtime)
    return [file.parent for file in closed] or [path]


def newest_bag(folder: Path) -> Path:
    """The recording that was closed last in a folder; raises InputError if there is none."""
    found = list(folder.glob(f"*/{METADATA_FILE}"))
    if not found:
        raise InputError(
            f"no recording in {folder.resolve()}: name one, or record one (./worm demo)"
        )
    return max(found, key=lambda path: path.stat().st_mtime).parent


def optimise(content: ParameterFile, direction: int, cache: Cache | None = None) -> Optimisation:
    """Front and price of robustness with the default settings, from the cache if they are in it."""
    cache, settings = cache or Cache.at(default_directory()), Settings()
    shown = arguments.shown_progress("margins")
    price = scanned_price(content, settings, direction, cache, shown)
    front = load_front(content, settings, direction, cache)
    if front is None:
        front = make_front(content, settings, direction, cache, arguments.shown_progress("front"))
    return Optimisation(front, price)


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
