# SPDX-License-Identifier: Apache-2.0
"""Command line: many robots, or many bags, on the cores of this machine or on a cluster."""

from __future__ import annotations

import argparse
import dataclasses
import sys
from pathlib import Path

from worm_model.commands.command_line import (
    FAILED,
    InputError,
    Parser,
    Progress,
    add_parameters,
    new_file,
    print_json,
)
from worm_optimizer.commands import arguments
from worm_optimizer.study.plan import Study, StudyError, load_study

try:
    from worm_optimizer.study.engine import ClusterError, LostError
    from worm_optimizer.study.page import write_page
    from worm_optimizer.study.run import Estimate, estimate, run_study
    from worm_optimizer.study.store import StoreError
except ModuleNotFoundError as error:  # the optional set, which a robot goes without
    sys.stderr.write(
        f"study: {error.name} is not installed: start it as ./worm study, or "
        "pip install -r requirements-study.txt -c constraints.txt\n"
    )
    sys.exit(2)


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
    add("--json", action="store_true", help="print one JSON object")
    add_parameters(parser)
    return parser


def _say(line: str) -> None:
    sys.stderr.write(f"study: {line}\n")


def _study(options: argparse.Namespace) -> int | None:
    if (options.study is None) == (options.bags is None):
        raise InputError("give either STUDY.yaml or --bags FOLDER")
    if options.workers is not None and not (options.workers >= 1 and not options.scheduler):
        raise InputError("--workers: give at least 1, and not beside --scheduler")
    page = new_file(options.page) if options.page else None
    if options.bags is not None:
        return _fleet(options, page)
    return _points(options, page)


def _points(options: argparse.Namespace, page: Path | None) -> None:
    """The study of a YAML file."""
    study = load_study(options.study, options.parameters)
    if options.dry_run:
        _tell_plan(study, estimate(study, options.scheduler, options.workers), options)
        return
    if options.output is None:
        raise InputError("--output is missing: name the study's output, e.g. STUDY.zarr")
    bar = Progress("study")
    where = options.output, options.scheduler, options.workers
    counts = run_study(study, *where, _say, bar)
    if page is not None:
        write_page(options.output, study, page)
    told = {**dataclasses.asdict(counts), "output": str(options.output)}
    if options.json:
        print_json(told)
        return
    arguments.say(
        f"{counts.done} of {counts.points} points in {options.output}, {counts.failed} of them failed"
    )
    if counts.failed:
        arguments.say("the variable reason says why a point failed")


def _tell_plan(study: Study, cost: Estimate, options: argparse.Namespace) -> None:
    """What a study would take."""
    blocks = len(study.blocks)
    if options.json:
        sizes = {"blocks": blocks, "block_points": study.block_points, **dataclasses.asdict(cost)}
        print_json({"points": study.size, "done": 0, "failed": 0, "output": None, **sizes})
        return
    arguments.say(
        f"{study.size} points in {blocks} blocks of {study.block_points}: about {cost.gaits:.2g} gaits, "
        f"{_duration(cost.seconds)} with {cost.workers} workers as fast as this machine"
    )


def _duration(seconds: float) -> str:
    for size, name in ((86400.0, "days"), (3600.0, "h"), (60.0, "min")):
        if seconds > 1.5 * size:
            return f"{seconds / size:.1f} {name}"
    return f"{seconds:.0f} s"


def main() -> int:
    """Entry point of the executable study."""

    def translated(options: argparse.Namespace) -> int | None:
        try:
            return _study(options)
        except (StudyError, StoreError, ClusterError) as error:
            raise InputError(str(error)) from None
        except LostError as error:
            _say(str(error))
            return FAILED

    return arguments.run(_parser(), translated)
