# SPDX-License-Identifier: Apache-2.0
"""Command line: computations for many parameter sets, on this machine or on a cluster.

The functions import what they use, so that --help takes no longer than for other commands.
"""

from __future__ import annotations

import argparse
import dataclasses
import math
from collections.abc import Mapping
from pathlib import Path
from textwrap import indent
from typing import TYPE_CHECKING, Any

from worm_model.commands import command_line
from worm_model.text_table import text_table

if TYPE_CHECKING:
    from worm_optimizer.robustness.sobol import Indices
    from worm_optimizer.study.blocks import Counts

_say = command_line.notifier("study")


def _parser() -> command_line.Parser:
    parser = command_line.Parser(
        prog="study",
        description="Compute fronts, gaits, cliffs and success probabilities for many parameter sets, on all cores of "
        "this machine or on a Dask cluster. Finished blocks are stored next to the output; after an interruption, the "
        "same command computes the others.",
    )
    add = parser.add_argument
    add("study", type=Path, metavar="STUDY.yaml", help="study file")
    add("--output", type=Path, metavar="STUDY.nc", help="NetCDF file of the results")
    add("--page", metavar="PAGE.html", help="write a page with figures of the results")
    add("--table", metavar="TABLE.csv", help="write a table with a row for each point")
    add(
        "--scheduler",
        default="",
        metavar="ADDRESS",
        help="address of a Dask cluster; default: this machine",
    )
    add("--workers", type=int, metavar="N", help="workers on this machine (default: one per core)")
    add("--dry-run", action="store_true", help="only print points, blocks and an estimated time")
    parser.add_json()
    parser.add_parameters("the file that the study names, else the paper's values")
    return parser


def _study(options: argparse.Namespace) -> int:
    if options.workers is not None and not (options.workers >= 1 and not options.scheduler):
        raise command_line.InputError(
            "--workers: give at least 1, and not together with --scheduler"
        )
    try:
        from worm_optimizer.study.blocks import LostError
    except ModuleNotFoundError as error:  # optional packages, which a robot does not need
        raise command_line.InputError(
            f"{error.name} is not installed: use ./worm study, which installs it, or "
            "pip install --group study -c constraints.txt"
        ) from None
    page = command_line.new_file(options.page) if options.page else None
    table = command_line.new_file(options.table) if options.table else None
    try:
        return _points(options, page, table)
    except LostError as error:
        _say(str(error))
        return command_line.FAILED


def _points(options: argparse.Namespace, page: Path | None, table: Path | None) -> int:
    """Compute a study, and return the exit status."""
    from worm_optimizer.robustness.sobol import index_json
    from worm_optimizer.study import study_run
    from worm_optimizer.study.blocks import Workers
    from worm_optimizer.study.study_file import load_study
    from worm_optimizer.study.study_page import write_page
    from worm_optimizer.study.summary import study_indices

    study = load_study(options.study, options.parameters)
    workers = Workers(options.scheduler, options.workers)
    if options.dry_run:
        seconds, count = study_run.estimate(study), workers.count()
        blocks = math.ceil(study.size / study.block_points)
        command_line.print_result(
            options,
            {
                "points": study.size,
                "block_points": study.block_points,
                "blocks": blocks,
                "seconds": seconds / count,
                "workers": count,
            },
            f"{study.size} points in {blocks} blocks of up to {study.block_points}: about "
            f"{command_line.duration(seconds / count)} with the {count} workers of this machine",
        )
        return command_line.DONE
    if options.output is None:
        raise command_line.InputError("--output is missing: name the study's output, e.g. STUDY.nc")
    counts = study_run.run_study(
        study, options.output, workers, _say, command_line.ProgressLine("study")
    )
    if page is not None:
        write_page(options.output, study, page)
    if table is not None:
        study_run.write_csv(options.output, table)
    indices = study_indices(options.output, study)
    inputs = [axis.name for axis in study.ranges]
    content = {"indices": {name: index_json(each, inputs) for name, each in indices.items()}}
    _print(options, counts, content if indices else {}, _indices_text(indices, inputs))
    return command_line.FAILED if counts.failed == counts.points else command_line.DONE


def _print(
    options: argparse.Namespace, counts: Counts, more: dict[str, Any], lines: list[str]
) -> None:
    content = {**dataclasses.asdict(counts), "output": str(options.output), **more}
    text = f"{counts.done} of {counts.points} points in {options.output}"
    if counts.failed:
        text += f"; {counts.failed} of them failed, the reasons are in the column reason"
    command_line.print_result(options, content, "\n".join([text, *lines]))


def _indices_text(indices: Mapping[str, Indices], inputs: list[str]) -> list[str]:
    from worm_optimizer.robustness.sobol import INDEX_HEADS, index_cells, warnings_of

    lines = []
    for name, each in indices.items():
        rows = [(key, *index_cells(each, k)) for k, key in enumerate(inputs)]
        lines.append(f"{name}: Sobol indices")
        lines.append(indent(text_table([("quantity", *INDEX_HEADS), *rows]), "  "))
        lines += [f"  warning: {text}" for text in warnings_of(name, each, inputs)]
    return lines


main = command_line.executable(_parser, _study)
