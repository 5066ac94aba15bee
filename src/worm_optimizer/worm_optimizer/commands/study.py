# SPDX-License-Identifier: Apache-2.0
"""Command line: many robots, or many bags, on the cores of this machine or on a cluster."""

from __future__ import annotations

import argparse
import dataclasses
import sys
from pathlib import Path

from worm_model.commands.command_line import (
    BAD_INPUT,
    FAILED,
    InputError,
    Parser,
    ProgressLine,
    new_file,
    notifier,
    print_result,
    run_command,
)
from worm_optimizer.study.plan import Study, load_study

try:
    from worm_optimizer.study.engine import LostError
    from worm_optimizer.study.fleet import read_fleet
    from worm_optimizer.study.fleet_page import write_fleet_page
    from worm_optimizer.study.study_page import write_page
    from worm_optimizer.study.study_run import Counts, Estimate, estimate, run_study
except ModuleNotFoundError as error:  # the optional set, which a robot goes without
    notifier("study")(
        f"{error.name} is not installed: start it as ./worm study, or "
        "pip install -r requirements-study.txt -c constraints.txt"
    )
    sys.exit(BAD_INPUT)

_say = notifier("study")


def _parser() -> Parser:
    parser = Parser(
        prog="study",
        description="Computes fronts, gaits, cliffs and success probabilities for many parameter sets, or reads "
        "many bags, on all cores of this machine or on a Dask cluster. What is finished stays: the same "
        "command goes on where it was.",
    )
    add = parser.add_argument
    add(
        "study", nargs="?", type=Path, metavar="STUDY.yaml", help="what varies and what is computed"
    )
    add("--bags", type=Path, metavar="FOLDER", help="read all bags below a folder instead")
    add(
        "--output",
        type=Path,
        metavar="OUT",
        help="STUDY.zarr, or FLEET.parquet for bags; goes on where it was",
    )
    add("--page", metavar="PAGE.html", help="a new page with figures of what is there")
    add(
        "--scheduler",
        default="",
        metavar="ADDRESS",
        help="of a Dask cluster; default: this machine",
    )
    add("--workers", type=int, metavar="N", help="on this machine (default: one a core)")
    add(
        "--dry-run", action="store_true", help="only tell points, gaits and an estimate of the time"
    )
    parser.add_json()
    parser.add_parameters()
    return parser


def _study(options: argparse.Namespace) -> None:
    if (options.study is None) == (options.bags is None):
        raise InputError("give either STUDY.yaml or --bags FOLDER")
    if options.workers is not None and not (options.workers >= 1 and not options.scheduler):
        raise InputError("--workers: give at least 1, and not beside --scheduler")
    page = new_file(options.page) if options.page else None
    if options.bags is not None:
        _fleet(options, page)
    else:
        _points(options, page)


def _points(options: argparse.Namespace, page: Path | None) -> None:
    """The study of a YAML file."""
    study = load_study(options.study, options.parameters)
    if options.dry_run:
        _tell_plan(study, estimate(study, options.scheduler, options.workers), options)
        return
    if options.output is None:
        raise InputError("--output is missing: name the study's output, e.g. STUDY.zarr")
    where = options.output, options.scheduler, options.workers
    counts = run_study(study, *where, _say, ProgressLine("study"))
    if page is not None:
        write_page(options.output, study, page)
    _tell(options, counts)


def _fleet(options: argparse.Namespace, page: Path | None) -> None:
    """All bags of a folder."""
    if options.output is None or options.output.suffix != ".parquet":
        raise InputError("--output: name the fleet's table, e.g. FLEET.parquet")
    where = options.output, options.scheduler, options.workers
    counts = read_fleet(options.bags, options.parameters, *where, _say, ProgressLine("bags"))
    if page is not None:
        write_fleet_page(options.output, options.parameters, page)
    _tell(options, counts)


def _tell(options: argparse.Namespace, counts: Counts) -> None:
    content = {**dataclasses.asdict(counts), "output": str(options.output)}
    what = "bags" if options.bags else "points"
    text = f"{counts.done} of {counts.points} {what} in {options.output}"
    if counts.failed:
        text += f"; {counts.failed} of them failed, their reason says why"
    print_result(options, content, text)


def _tell_plan(study: Study, cost: Estimate, options: argparse.Namespace) -> None:
    """What a study would take."""
    sizes = {"blocks": len(study.blocks), "block_points": study.block_points}
    content = {"points": study.size, "done": 0, "failed": 0, "output": None, **sizes}
    print_result(
        options,
        {**content, **dataclasses.asdict(cost)},
        f"{study.size} points in {sizes['blocks']} blocks of {study.block_points}: about "
        f"{cost.gaits:.2g} gaits, {_duration(cost.seconds)} with {cost.workers} workers as fast as this machine",
    )


def _duration(seconds: float) -> str:
    for size, name in ((86400.0, "days"), (3600.0, "h"), (60.0, "min")):
        if seconds > 1.5 * size:
            return f"{seconds / size:.1f} {name}"
    return f"{seconds:.0f} s"


def main() -> int:
    """Entry point of the executable study."""

    def told(options: argparse.Namespace) -> int | None:
        try:
            _study(options)
        except LostError as error:
            _say(str(error))
            return FAILED
        return None

    return run_command(_parser(), told)
