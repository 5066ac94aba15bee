# SPDX-License-Identifier: Apache-2.0
"""Command line: the validation campaign, on the virtual robot or on a real one."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from worm_model.commands.command_line import (
    FAILED,
    InputError,
    Parser,
    notifier,
    print_result,
    run_command,
)
from worm_model.parameters import load_parameter_file
from worm_optimizer.commands.robot_options import add_robot, robot_of
from worm_optimizer.commands.search_options import shown_progress
from worm_optimizer.operation.bring_up import (
    FAILURES,
    Narrator,
    work_folder,
)
from worm_optimizer.operation.campaign_plan import (
    PROMISES,
    Plan,
    is_promised,
    make_plan,
    write_promises,
)
from worm_optimizer.operation.campaign_runs import run_gaits
from worm_optimizer.operation.processes import termination_as_interrupt
from worm_optimizer.report.agreement import agreement_json, describe
from worm_optimizer.report.identification_parts import add_identification, identification_of
from worm_optimizer.report.recorded_gait import RecordedGait
from worm_optimizer.report.recordings import read_recorded_gaits
from worm_optimizer.report.report_page import Report, build_report
from worm_optimizer.search.cache import Cache, default_directory
from worm_optimizer.search.search_settings import Settings

_MODES = ("virtual", "robot")


def main() -> int:
    """Entry point of the executable campaign."""
    return run_command(_parser(), _campaign)


def _parser() -> Parser:
    parser = Parser(
        prog="campaign",
        description="Runs the minimum-power, cruising and maximum-speed gaits of the robust front, five cycles each, "
        "on the virtual robot or on a real one, records each, and compares what was measured with what was predicted.",
    )
    add = parser.add_argument
    parser.add_argument(
        "--mode", choices=_MODES, default=_MODES[0], help="which robot (default: virtual)"
    )
    add_robot(parser)
    add(
        "--output",
        type=Path,
        metavar="FOLDER",
        help="a new folder for bags and report (default: bags/campaign_TIME)",
    )
    parser.add_argument(
        "--resume",
        type=Path,
        metavar="FOLDER",
        help="go on with a campaign that was broken off: its folder, and otherwise the options it was begun with; "
        "gaits that are recorded are kept",
    )
    parser.add_number("--margin", "M", "robustness margin in m; default: at the cliff")
    parser.add_direction()
    add_identification(parser)
    parser.add_json()
    parser.add_parameters()
    return parser


def _campaign(options: argparse.Namespace) -> int:
    content = load_parameter_file(options.parameters)
    identification = identification_of(options)
    robot = robot_of(options, options.mode)
    folder = _folder(options)
    say = Narrator("campaign")
    settings, cache = Settings(margin=options.margin), Cache.at(default_directory())
    shown = shown_progress("front")
    plan = make_plan(content, settings, options.direction, cache, shown)
    _promise(plan, folder, options)
    try:
        with termination_as_interrupt(), work_folder("campaign") as work:
            gaits = {name: prediction.gait for name, prediction in plan.gaits.items()}
            run_gaits(robot.in_folder(work), gaits, folder, work / "logs", say)
    except FAILURES as error:
        print(f"campaign: {error}\ncampaign: go on with --resume {folder}", file=sys.stderr)  # noqa: T201
        return FAILED
    say("comparing")
    bags = [folder / name for name in plan.gaits]
    recorded = read_recorded_gaits(bags, options.parameters, notifier("campaign"))
    title = f"Validation campaign ({options.mode} robot)"
    report = Report(title, recorded, plan.optimisation, identification=identification)
    _print(options, recorded, folder, build_report(report, folder / "report"))
    return 0


def _folder(options: argparse.Namespace) -> Path:
    """Where bags and report go. Raises InputError."""
    if options.resume is not None:
        if options.output is not None:
            raise InputError("--resume names the folder: leave --output out")
        resumed: Path = options.resume.resolve()
        if not (resumed / PROMISES).is_file():
            raise InputError(f"{resumed}: no campaign was begun there ({PROMISES} is missing)")
        if (resumed / "report").exists():
            raise InputError(f"{resumed}: this campaign is complete, its report is there")
        return resumed
    default = Path("bags") / time.strftime("campaign_%Y_%m_%d-%H_%M_%S")
    folder: Path = (options.output or default).resolve()
    if folder.exists():
        raise InputError(
            f"{folder}: exists already; give another name with --output, or go on with --resume"
        )
    return folder


def _promise(plan: Plan, folder: Path, options: argparse.Namespace) -> None:
    """Writes the promises of a new campaign down; those of one that goes on must be the same."""
    if options.resume is None:
        folder.mkdir(parents=True)
        write_promises(plan, folder)
    elif not is_promised(plan, folder):
        raise InputError(
            f"{folder} was begun with other gaits than these options make: give those it was begun with"
        )


def _print(
    options: argparse.Namespace, gaits: Sequence[RecordedGait], folder: Path, page: Path
) -> None:
    content = {"folder": str(folder), "page": str(page), **agreement_json(gaits)}
    print_result(options, content, f"{describe(gaits)}\n\nrecordings  {folder}\nreport      {page}")
