# SPDX-License-Identifier: Apache-2.0
"""Command line: computations for many parameter sets, on this machine or on a cluster.

The functions import what they use, so that --help takes no longer than for other commands.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from worm_model.commands import command_line


def _parser() -> command_line.Parser:
    parser = command_line.Parser(
        prog="study",
        description="Compute fronts, gaits, cliffs and success probabilities for many parameter sets, on all cores of "
        "this machine or on a Dask cluster. Finished blocks are stored next to the output; after an interruption, the "
        "same command computes the others.",
    )
    add = parser.add_argument
    add("study", type=Path, metavar="STUDY.yaml", help="study file")
    add("--output", type=Path, required=True, metavar="STUDY.nc", help="NetCDF file of the results")
    add(
        "--scheduler",
        default="",
        metavar="ADDRESS",
        help="address of a Dask cluster; default: this machine",
    )
    add("--workers", type=int, metavar="N", help="workers on this machine (default: one per core)")
    parser.add_json()
    parser.add_parameters("the paper's values, or the files that the study names")
    return parser


def _study(options: argparse.Namespace) -> int:
    if options.workers is not None and not (options.workers >= 1 and not options.scheduler):
        raise command_line.InputError(
            "--workers: give at least 1, and not together with --scheduler"
        )
    try:
        from worm_optimizer.study.blocks import LostError, Workers
        from worm_optimizer.study.study_file import load_study
        from worm_optimizer.study.study_run import run_study
    except ModuleNotFoundError as error:  # optional packages, which a robot does not need
        raise command_line.InputError(
            f"{error.name} is not installed: use ./worm study, which installs it, or "
            "pip install --group study -c constraints.txt"
        ) from None
    study = load_study(options.study, options.parameters)
    workers = Workers(options.scheduler, options.workers)
    say, progress = command_line.notifier("study"), command_line.ProgressLine("study")
    try:
        failed = run_study(study, options.output, workers, say, progress)
    except LostError as error:
        say(str(error))
        return command_line.FAILED
    points = study.file.size
    text = f"{points} points in {options.output}"
    if failed:
        text += f"; {failed} of them failed, the reasons are in the variable reason"
    content = {"points": points, "done": points, "failed": failed, "output": str(options.output)}
    command_line.print_result(options, content, text)
    return command_line.FAILED if failed == points else command_line.DONE


main = command_line.executable(_parser, _study)
