# SPDX-License-Identifier: Apache-2.0
"""Command line: identification of a parameter file with intervals from bags or a lab's folder."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from worm_model.commands.command_line import (
    Parser,
    ProgressLine,
    executable,
    new_file,
    print_result,
)
from worm_model.parameters import ParameterFile, load_parameter_file, write_parameter_file

if TYPE_CHECKING:
    from worm_model.identification.inputs import Inputs
    from worm_model.identification.reference_values import ReferenceValues
    from worm_model.identification.stages import Identification


def _parser() -> Parser:
    parser = Parser(
        prog="identify",
        description="Identify the robot's parameters from recorded runs, each from rest over five ridges.",
        epilog="Masses, pitch and unstressed length come from --parameters, else from the README.md of a lab's folder, "
        "else from the paper.",
    )
    parser.add_argument(
        "runs",
        type=Path,
        nargs="+",
        metavar="BAG",
        help="bags with one run each, a lab's folder of runs, or some runs of it",
    )
    parser.add_argument(
        "--bellows", type=Path, metavar="CSV", help="bellows test: compression_m, force_N"
    )
    parser.add_argument("--fin", type=Path, metavar="CSV", help="fin test: displacement_m, force_N")
    parser.add_argument("--output", metavar="FILE", help="new parameter file; must not exist")
    parser.add_argument("--report", metavar="DIR", help="folder for the report; must not exist")
    parser.add_argument(
        "--one-sided-cable",
        action="store_true",
        help="fit the power model of a cable that cannot push, and store this choice in the parameter file; default: "
        "the power model of --parameters, else the paper's",
    )
    parser.add_json()
    parser.add_parameters("README.md of a lab's folder, else the paper's values")
    return parser


class StageProgress:
    """Progress line for each stage."""

    def __init__(self) -> None:
        self._stage, self._line = "", ProgressLine("")

    def __call__(self, stage: str, done: float) -> None:
        """Show the progress of a stage, from 0 to 1."""
        if stage != self._stage:
            self._stage, self._line = stage, ProgressLine(stage)
        self._line(done)


def _reference(options: argparse.Namespace, inputs: Inputs) -> ReferenceValues:
    from worm_model.identification.reference_values import reference_by_file, reference_by_folder

    if options.parameters:
        file = load_parameter_file(options.parameters)
        reference = reference_by_file(file, Path(options.parameters).name)
    elif inputs.folder is not None:
        reference = reference_by_folder(inputs.folder)
    else:
        reference = reference_by_file(ParameterFile(), "the paper")
    return reference.with_one_sided_cable() if options.one_sided_cable else reference


def _describe(result: Identification, advice: str) -> str:
    from worm_model.identification.report.identification_report import (
        error_table,
        parameter_table,
        travel_text,
    )

    parts = [
        result.fit.text,
        parameter_table(result.estimates),
        "Held-out errors, in brackets with the paper's table:\n" + error_table(result),
        travel_text(result),
        f"Recommended measurement: {advice}.",
    ]
    return "\n\n".join(parts)


def _run(options: argparse.Namespace) -> None:
    # here: SciPy and Numba load slowly
    from worm_model.identification.inputs import read_inputs
    from worm_model.identification.report.advice import advise
    from worm_model.identification.report.identification_report import (
        parameter_file,
        summary,
        write_report,
    )
    from worm_model.identification.stages import identify

    output = new_file(options.output) if options.output else None
    report = new_file(options.report) if options.report else None
    reporter = StageProgress()
    inputs = read_inputs(options.runs, options.bellows, options.fin)
    result = identify(inputs, _reference(options, inputs), reporter)
    advice = advise(result)
    if output is not None:
        write_parameter_file(output, parameter_file(result, inputs))
    if report is not None:
        write_report(result, advice, report, lambda done: reporter("report", done))
    for warning in result.warnings:
        sys.stderr.write(f"{warning}\n")
    for path in (output, report):
        if path is not None:
            sys.stderr.write(f"identify: wrote {path}\n")
    print_result(options, summary(result) | {"advice": advice}, _describe(result, advice))


main = executable(_parser, _run)
