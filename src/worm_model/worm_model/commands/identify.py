# SPDX-License-Identifier: Apache-2.0
"""Command line: identification of a parameter file with intervals from bags or a lab's folder."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from worm_model.commands.command_line import (
    InputError,
    Parser,
    ProgressLine,
    executable,
    new_file,
    print_result,
)
from worm_model.parameters import (
    FORM,
    KEYS,
    MADE_BY,
    PAPER,
    UNITS,
    ParameterFile,
    load_parameter_file,
    write_parameter_file,
)

if TYPE_CHECKING:
    from worm_model.identification.inputs import Inputs
    from worm_model.identification.reference_values import ReferenceValues
    from worm_model.identification.stages import Identification

SIDES = {"positive": 1, "negative": -1}


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
    parser.add_argument(
        "--fin-engages",
        choices=sorted(SIDES),
        help="sign of the displacement in which the tested fin engages; default: its stiffer side",
    )
    parser.add_argument(
        "--validation",
        type=Path,
        nargs="+",
        default=[],
        metavar="BAG",
        help="runs for validation, which are not fitted",
    )
    parser.add_argument("--output", metavar="FILE", help="new parameter file; must not exist")
    parser.add_argument("--report", metavar="DIR", help="folder for the report; must not exist")
    parser.add_argument(
        "--seed", type=int, default=0, metavar="N", help="seed of the bootstrap (default 0)"
    )
    parser.add_argument(
        "--literal",
        action="store_true",
        help="for comparison, run the paper's procedure: its cost functions, no nuisance parameters, no intervals",
    )
    parser.add_argument(
        "--one-sided-cable",
        action="store_true",
        help="fit the power model of a cable that cannot push, and store this choice in the parameter file; default: "
        "the power model of --parameters, else the paper's",
    )
    parser.add_transmission()
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
    reference = _given(options, inputs)
    return reference.with_one_sided_cable() if options.one_sided_cable else reference


def _given(options: argparse.Namespace, inputs: Inputs) -> ReferenceValues:
    from worm_model.identification.reference_values import reference_by_file, reference_by_folder

    if options.parameters:
        return reference_by_file(
            load_parameter_file(options.parameters), Path(options.parameters).name
        )
    if inputs.folder is not None:
        return reference_by_folder(inputs.folder)
    return reference_by_file(ParameterFile(), "the paper")


def _literal(options: argparse.Namespace, inputs: Inputs, output: Path | None) -> None:
    """Run the paper's procedure; see `worm_model.identification.paper_procedure`."""
    from worm_model.identification.paper_procedure import literal

    if options.report or options.validation:
        raise InputError(
            "--literal supports neither report nor validation; remove --report and --validation"
        )
    if options.one_sided_cable:
        raise InputError(
            "--literal uses the paper's power model; remove --one-sided-cable or --literal"
        )
    reference = _reference(options, inputs)
    parameters, costs = literal(
        inputs, reference.parameters, StageProgress(), SIDES.get(options.fin_engages, 0)
    )
    if output is not None:
        provenance = {"made_by": f"{MADE_BY} --literal", FORM: False, "given": reference.source}
        write_parameter_file(output, ParameterFile(parameters, {}, provenance))
    unknown = {"low": None, "high": None, "identifiable": True}
    values = {key: getattr(parameters, key) for key in KEYS}
    content = {
        "parameters": {key: {"value": value, **unknown} for key, value in values.items()},
        FORM: False,
        "costs": costs,
    }
    lines = [
        f"{key:22} {value:12.6g} {UNITS[key]:6}  (paper: {getattr(PAPER, key):g})"
        for key, value in values.items()
    ]
    lines += [f"{name:22} {cost:12.6g}" for name, cost in costs.items()]
    for remark in inputs.remarks:
        sys.stderr.write(f"{remark}\n")
    print_result(options, content, "\n".join(lines))


def _describe(result: Identification, advice: str) -> str:
    from worm_model.identification.report.identification_report import (
        error_table,
        parameter_table,
        travel_text,
    )

    parts = [
        result.fit.text,
        parameter_table(result.estimates),
        "Held-out errors, in brackets with the paper's table:\n"
        + error_table(result.held_out, result.paper),
    ]
    parts.append(travel_text(result))
    if result.validation:
        parts.append("Errors of the validation runs:\n" + error_table(result.validation, {}))
    return "\n\n".join([*parts, f"Recommended measurement: {advice}."])


def _run(options: argparse.Namespace) -> None:
    # here: SciPy and Numba load slowly
    from worm_model.identification.data.lab_logs import LabSettings
    from worm_model.identification.inputs import read_inputs, read_recordings
    from worm_model.identification.report.advice import advise
    from worm_model.identification.report.identification_report import (
        parameter_file,
        summary,
        write_report,
    )
    from worm_model.identification.stages import identify

    output = new_file(options.output) if options.output else None
    report = new_file(options.report) if options.report else None
    if options.seed < 0:
        raise InputError("--seed must not be negative")
    if (options.spool_radius or 1.0) <= 0:
        raise InputError("--spool-radius must be positive")
    reporter = StageProgress()
    logs = LabSettings(onset=options.onset, spool_radius=options.spool_radius)
    inputs = read_inputs(options.runs, options.bellows, options.fin, logs)
    if options.literal:
        _literal(options, inputs, output)
        return
    result = identify(
        inputs,
        _reference(options, inputs),
        options.seed,
        SIDES.get(options.fin_engages, 0),
        read_recordings(options.validation, logs),
        reporter,
    )
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
