# SPDX-License-Identifier: Apache-2.0
"""Command line: computations for many parameter sets, or for many bags, on this machine or on a cluster."""

from __future__ import annotations

import argparse
import dataclasses
import sys
from collections.abc import Mapping
from pathlib import Path
from textwrap import indent
from typing import Any

from worm_model.commands import command_line
from worm_model.text_table import text_table
from worm_optimizer.study.plan import Study
from worm_optimizer.study.study_file import load_study

try:
    from worm_optimizer.study.engine import LostError
    from worm_optimizer.study.fleet import read_fleet, reopen_fleet
    from worm_optimizer.study.fleet_page import write_fleet_page
    from worm_optimizer.study.results import check_export, export
    from worm_optimizer.study.sobol import INDEX_HEADS, Indices, index_cells, warnings_of
    from worm_optimizer.study.store import is_of_this_code, stored_study
    from worm_optimizer.study.study_indices import study_indices
    from worm_optimizer.study.study_page import write_page
    from worm_optimizer.study.study_run import (
        Counts,
        Workers,
        estimate,
        retry_study,
        run_study,
        verify_store,
    )
except ModuleNotFoundError as error:  # optional packages, which a robot does not need
    command_line.notifier("study")(
        f"{error.name} is not installed: use ./worm study, which installs it, or "
        "pip install -r requirements-study.txt -c constraints.txt"
    )
    sys.exit(command_line.BAD_INPUT)

_say = command_line.notifier("study")


def _parser() -> command_line.Parser:
    parser = command_line.Parser(
        prog="study",
        description="Compute fronts, gaits, cliffs and success probabilities for many parameter sets, or read many "
        "bags, on all cores of this machine or on a Dask cluster. Finished blocks are stored. Repeating the command "
        "verifies them and computes the others.",
    )
    add = parser.add_argument
    add("study", nargs="?", type=Path, metavar="STUDY.yaml", help="study file")
    add("--bags", type=Path, metavar="FOLDER", help="read all bags below a folder instead")
    add(
        "--from",
        dest="source",
        type=Path,
        metavar="STORE",
        help="compute the study that a store describes; without --output, continue this store",
    )
    add("--verify", type=Path, metavar="STORE", help="only compare a store with its checksums")
    add(
        "--output",
        type=Path,
        metavar="OUT",
        help="STUDY.zarr, or FLEET.parquet for bags; an unfinished output is continued",
    )
    add("--page", metavar="PAGE.html", help="write a page with figures of the results")
    add("--export", metavar="FILE", help="write the results as NetCDF (.nc) or as a table (.csv)")
    add(
        "--scheduler",
        default="",
        metavar="ADDRESS",
        help="address of a Dask cluster; default: this machine",
    )
    add("--workers", type=int, metavar="N", help="workers on this machine (default: one per core)")
    add("--retry-failed", action="store_true", help="compute failed points or bags again")
    add(
        "--accept-failures",
        action="store_true",
        help="exit status 0 even if all points or some bags fail",
    )
    add("--dry-run", action="store_true", help="only print points, blocks and an estimated time")
    parser.add_json()
    parser.add_parameters(
        "the file that the study names, with --bags the file in each bag, else the paper's values"
    )
    return parser


def _study(options: argparse.Namespace) -> int:
    sources = options.study, options.bags, options.source, options.verify
    if sum(source is not None for source in sources) != 1:
        raise command_line.InputError(
            "give one of STUDY.yaml, --bags FOLDER, --from STORE and --verify STORE"
        )
    if options.workers is not None and not (options.workers >= 1 and not options.scheduler):
        raise command_line.InputError(
            "--workers: give at least 1, and not together with --scheduler"
        )
    if options.verify is not None:
        return _verify(options)
    page = command_line.new_file(options.page) if options.page else None
    if options.bags is not None:
        return _fleet(options, page)
    return _points(options, page)


def _verify(options: argparse.Namespace) -> int:
    """Compare a store with its checksums, and return the exit status."""
    counts, damaged = verify_store(options.verify, _say)
    content = {**dataclasses.asdict(counts), "damaged": damaged, "output": str(options.verify)}
    text = f"{counts.done} of {counts.points} points in {options.verify}; {damaged} of them are damaged"
    if damaged:
        text += f": ./worm study --from {options.verify} computes them again"
    command_line.print_result(options, content, text)
    return command_line.FAILED if damaged else command_line.DONE


def _points(options: argparse.Namespace, page: Path | None) -> int:
    """Compute a study, and return the exit status."""
    study, output = _described(options)
    workers = Workers(options.scheduler, options.workers)
    if options.dry_run:
        cost = estimate(study, workers, _say)
        command_line.print_result(
            options,
            {"points": study.size, "block_points": study.block_points, **dataclasses.asdict(cost)},
            f"{study.size} points in {cost.blocks} blocks of up to {study.block_points}: about "
            f"{command_line.duration(cost.seconds)} with {cost.workers} workers, if each is as fast as this machine",
        )
        return command_line.DONE
    if output is None:
        raise command_line.InputError(
            "--output is missing: name the study's output, e.g. STUDY.zarr"
        )
    file = command_line.new_file(options.export) if options.export else None
    if file is not None:
        check_export(file)
    compute = retry_study if options.retry_failed else run_study
    counts = compute(study, output, workers, _say, command_line.ProgressLine("study"))
    if page is not None:
        write_page(output, study, page)
    if file is not None:
        export(output, file)
    indices = study_indices(output, study)
    inputs = [axis.name for axis in study.ranges]
    content = {"indices": _indices_json(indices, inputs)} if indices else {}
    _print(options, counts, output, content, _indices_text(indices, inputs))
    return _status(options, counts, tolerated=counts.points - 1)


def _described(options: argparse.Namespace) -> tuple[Study, Path | None]:
    """Return the study, and the path of its output; None if the options contain none."""
    if options.source is None:
        return load_study(options.study, options.parameters), options.output
    if options.parameters:
        raise command_line.InputError(
            "--parameters: the store contains the parameters; remove the option"
        )
    study, output = stored_study(options.source), options.output or options.source
    if output != options.source and not is_of_this_code(options.source):
        _say(f"{options.source} was computed by another version of the code, {output} by this one")
    return study, output


def _fleet(options: argparse.Namespace, page: Path | None) -> int:
    """Read all bags of a folder, and return the exit status."""
    if options.output is None or options.output.suffix != ".parquet":
        raise command_line.InputError("--output: name the fleet's table, e.g. FLEET.parquet")
    if options.export or options.dry_run:
        raise command_line.InputError(
            "--export and --dry-run are for studies; remove them, or --bags"
        )
    where = options.bags, options.parameters, options.output
    if options.retry_failed:
        reopen_fleet(*where)
    workers = Workers(options.scheduler, options.workers)
    counts = read_fleet(*where, workers, _say, command_line.ProgressLine("bags"))
    if page is not None:
        write_fleet_page(options.output, options.parameters, page)
    _print(options, counts, options.output, {}, [])
    return _status(options, counts, tolerated=0)


def _status(options: argparse.Namespace, counts: Counts, tolerated: int) -> int:
    """Return the exit status. If more than ``tolerated`` points or bags failed, print a message, too."""
    if counts.failed <= tolerated or options.accept_failures:
        return command_line.DONE
    _say(
        f"{counts.failed} of {counts.points} failed, so the exit status is {command_line.FAILED}; "
        "with --accept-failures it is 0"
    )
    return command_line.FAILED


def _print(
    options: argparse.Namespace,
    counts: Counts,
    output: Path,
    more: dict[str, Any],
    lines: list[str],
) -> None:
    content = {**dataclasses.asdict(counts), "output": str(output), **more}
    what = "bags" if options.bags else "points"
    text = f"{counts.done} of {counts.points} {what} in {output}"
    if counts.failed:
        text += f"; {counts.failed} of them failed, the reasons are in the column reason"
    command_line.print_result(options, content, "\n".join([text, *lines]))


def _indices_json(indices: Mapping[str, Indices], inputs: list[str]) -> dict[str, Any]:
    return {
        name: {
            key: {
                "first": each.first[k],
                "first_bounds": each.first_bounds[:, k],
                "total": each.total[k],
                "total_bounds": each.total_bounds[:, k],
            }
            for k, key in enumerate(inputs)
        }
        for name, each in indices.items()
    }


def _indices_text(indices: Mapping[str, Indices], inputs: list[str]) -> list[str]:
    lines = []
    for name, each in indices.items():
        rows = [(key, *index_cells(each, k)) for k, key in enumerate(inputs)]
        lines.append(f"{name}: Sobol indices")
        lines.append(indent(text_table([("quantity", *INDEX_HEADS), *rows]), "  "))
        lines += [f"  warning: {text}" for text in warnings_of(name, each, inputs)]
    return lines


def main() -> int:
    """Entry point of the executable study."""

    def reported(options: argparse.Namespace) -> int:
        try:
            return _study(options)
        except LostError as error:
            _say(str(error))
            return command_line.FAILED

    return command_line.run_command(_parser(), reported)
