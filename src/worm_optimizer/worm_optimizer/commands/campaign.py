# SPDX-License-Identifier: Apache-2.0
"""Command line: the validation campaign, on the virtual robot or on a real one.

The functions import what they use, because these imports take seconds, and --help needs none of them.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from worm_model.commands.command_line import (
    FAILED,
    Parser,
    executable,
    finite,
    notifier,
    print_result,
)
from worm_model.commands.identify import StageProgress
from worm_model.errors import InputError
from worm_model.parameters import load_parameter_file
from worm_model.text_table import labelled
from worm_optimizer.commands.report import add_identification
from worm_optimizer.commands.robot_options import add_robot, robot_of
from worm_optimizer.commands.search_options import add_campaign_options
from worm_optimizer.commands.tuning_options import PROBABILITY
from worm_optimizer.nodes.service_caller import OperatorError
from worm_optimizer.operation.bring_up import CYCLES, FAILURES, ProgressLog, Session, work_folder
from worm_optimizer.operation.processes import termination_as_interrupt
from worm_optimizer.operation.system import Robot
from worm_optimizer.robot_commands import GaitCommand

if TYPE_CHECKING:
    from worm_optimizer.operation.campaign_plan import Plan
    from worm_optimizer.operation.campaign_runs import Prepare
    from worm_optimizer.operation.spread import Spread
    from worm_optimizer.report.identification_parts import IdentificationParts
    from worm_optimizer.report.recorded_gait import RecordedGait

_GAITS = 3  # gaits of a plan without comparisons; with more runs than this, the spread is drawn
SPREAD_FIGURE = "spread.png"
_MODES = ("virtual", "robot")
SAME_PLACE = "Put the robot where the first run began: same grooves, fins straight"


def _parser() -> Parser:
    parser = Parser(
        prog="campaign",
        description="Run the minimum-power, cruising and maximum-speed gaits of the robust front, five cycles each, "
        "on the virtual robot or on a real one, record them, and compare measurements with predictions. With "
        "conditions in the pipe, each gait is followed by its counterpart for level ground. If the gaits have other "
        "waveforms, each is followed by a gait with the paper's sinusoid.",
    )
    add = parser.add_argument
    parser.add_argument(
        "--mode", choices=_MODES, default=_MODES[0], help="kind of robot (default: virtual)"
    )
    add_robot(parser)
    add(
        "--output",
        type=Path,
        metavar="FOLDER",
        help="new folder for bags and report (default: bags/campaign_TIME)",
    )
    parser.add_argument(
        "--resume",
        type=Path,
        metavar="FOLDER",
        help="folder of an interrupted campaign to continue, with the other options as at its start; "
        "recorded gaits are not repeated",
    )
    add_campaign_options(parser)
    parser.add_direction()
    add(
        "--repeats",
        type=int,
        default=1,
        metavar="N",
        help="runs of each gait (default: 1); their spread is printed, and drawn in spread.png if the campaign has "
        "more than three runs in total",
    )
    add(
        "--with-nominal",
        action="store_true",
        help="also run the three gaits that are best without a margin",
    )
    add(
        "--identify",
        action="store_true",
        help="first run each gait of the identification until the robot has passed five ridges, and write the "
        "identified parameters and a report. Then validate these parameters with their robust and nominal gaits. "
        "On a real robot, the "
        "command prompts before each run. --bellows and --fin are the files of the bench tests",
    )
    add(
        "--tune",
        action="store_true",
        help="first run each of the three gaits, measure its margin, and repeat with the next gait, at most five runs, "
        f"until a cycle keeps its grooves with --probability (here by default {PROBABILITY}). Then validate the tuned "
        "gaits",
    )
    add_identification(parser)
    parser.add_json()
    parser.add_parameters()
    return parser


def _campaign(options: argparse.Namespace) -> int:
    from worm_optimizer.commands.campaign_tune import tuned_plan
    from worm_optimizer.operation import identification_runs
    from worm_optimizer.operation.campaign_runs import run_gaits
    from worm_optimizer.operation.spread import run_names
    from worm_optimizer.report.identification_parts import identification_of

    load_parameter_file(options.parameters)
    if options.repeats < 1:
        raise InputError(f"--repeats {options.repeats}: give 1 or more")
    if options.identify and options.identification:
        raise InputError("--identify creates the identification: remove --identification")
    identification = None if options.identify else identification_of(options)
    robot = robot_of(options, options.mode)
    folder = _folder(options)
    say = ProgressLog("campaign")
    summary: dict[str, Any] = {}
    try:
        with termination_as_interrupt(), work_folder("campaign") as work:
            robot = robot.in_folder(work)
            if options.identify:
                summary = _identify(options, robot, folder, work, say)
                options.parameters = str(folder / identification_runs.PARAMETERS)
                robot = robot.with_parameters(options.parameters)
                options.identification = [
                    folder / identification_runs.PARAMETERS,
                    folder / identification_runs.REPORT,
                ]
                identification = identification_of(options)
            plan = _plan(options, robot)
            ask = _prompt("Put the robot where it has room") if _prompts(options) else _at_once
            if options.tune:
                plan, summary["tuning"] = tuned_plan(options, robot, plan, (folder, work), say, ask)
            _promise(plan, folder)
            names = run_names(tuple(plan.gaits), options.repeats)
            orders = {
                run: GaitCommand(plan.gaits[name].gait, CYCLES) for run, name in names.items()
            }
            (work / "logs" / "validation").mkdir()
            run_gaits(robot, orders, folder, work / "logs" / "validation", say, ask)
    except FAILURES as error:
        sys.stderr.write(f"campaign: {error}\n{_hint(options, folder)}")
        return FAILED
    except KeyboardInterrupt:
        sys.stderr.write(_hint(options, folder))
        raise
    say("comparing")
    _compare(options, plan, names, folder, identification, summary, say)
    return 0


def _compare(
    options: argparse.Namespace,
    plan: Plan,
    names: Mapping[str, str],
    folder: Path,
    identification: IdentificationParts | None,
    summary: dict[str, Any],
    say: ProgressLog,
) -> None:
    """Write the report on the runs, whose gaits ``names`` contains by run, and print it with the ``summary``."""
    from worm_optimizer.operation.campaign_runs import put_aside
    from worm_optimizer.operation.spread import draw_spread, spread
    from worm_optimizer.report.recordings import read_recorded_gaits
    from worm_optimizer.report.report_page import Report, build_report

    bags = [folder / run for run in names]
    recorded = read_recorded_gaits(bags, options.parameters, notifier("campaign"))
    title = f"Validation campaign ({options.mode} robot)"
    report = Report(title, recorded, plan.optimisation, identification=identification)
    spreads = [
        spread(
            name, promise, [r for run, r in zip(names, recorded, strict=True) if names[run] == name]
        )
        for name, promise in plan.gaits.items()
    ]
    put_aside(folder / "report", say)
    page = build_report(report, folder / "report")
    if len(recorded) > _GAITS:
        draw_spread(folder / SPREAD_FIGURE, spreads)
    _print(options, recorded, spreads, folder, page, summary)


def _plan(options: argparse.Namespace, robot: Robot) -> Plan:
    """Return the plan of the validation: three gaits of the exact front, and the gaits to compare them with."""
    from worm_optimizer.commands.campaign_tune import settings_of_campaign
    from worm_optimizer.operation.campaign_plan import make_plan, with_comparisons

    content = load_parameter_file(options.parameters)
    settings = settings_of_campaign(options, robot)
    plan = make_plan(content, settings, options.direction)
    nominal = options.with_nominal or options.identify
    return with_comparisons(plan, content, settings, options.direction, nominal=nominal)


def _identify(
    options: argparse.Namespace, robot: Robot, folder: Path, work: Path, say: ProgressLog
) -> dict[str, Any]:
    """Record the missing runs, and identify the parameters unless the results exist.

    Return the results of `identify`, the path of the parameter file and the paths of the bags.
    """
    from worm_optimizer.operation import identification_runs
    from worm_optimizer.operation.campaign_runs import put_aside

    known = load_parameter_file(options.parameters)
    folder.mkdir(parents=True, exist_ok=True)
    orders = identification_runs.identification_orders(options.direction, known.parameters.pitch)
    (work / "logs" / "identification").mkdir()
    logs = work / "logs" / "identification"
    ask = _prompt(SAME_PLACE) if _prompts(options) else identification_runs.put_back
    bags = identification_runs.record_identification(robot, orders, folder, logs, say, ask)
    summary_file = folder / identification_runs.SUMMARY
    if not summary_file.exists():
        for left in (
            folder / identification_runs.REPORT,
            folder / identification_runs.PARAMETERS,
        ):
            put_aside(left, say)  # incomplete results of an interrupted identification
        say("identifying")
        source = options.parameters or "the paper"
        bench = identification_runs.Bench(options.bellows, options.fin)
        if options.mode == "virtual" and bench == identification_runs.Bench(None, None):
            bench = identification_runs.virtual_bench(robot, folder, work / "logs")
        result = identification_runs.identify_robot(
            bags, bench, (known, source), folder, StageProgress()
        )
        summary_file.write_text(json.dumps(finite(result)), encoding="utf-8")
    content: dict[str, Any] = json.loads(summary_file.read_text(encoding="utf-8"))
    return content | {
        "parameter_file": str(folder / identification_runs.PARAMETERS),
        "bags": [str(b) for b in bags],
    }


def _prompts(options: argparse.Namespace) -> bool:
    """Return True if the operator is prompted before each run: in a campaign of a real robot with --identify."""
    return bool(options.identify) and options.mode == "robot"


def _at_once(_running: Session, _text: str) -> None:
    """Do nothing before a run."""


def _prompt(instruction: str) -> Prepare:
    """Return a function that prompts the operator before each run, and waits for Enter."""

    def ask(_running: Session, text: str) -> None:
        sys.stderr.write(f"{text}\n{instruction}; Enter starts the run, Ctrl-C ends the campaign: ")
        sys.stderr.flush()
        if not sys.stdin.readline():
            raise OperatorError(
                "standard input has ended: a real robot moves only after Enter on a terminal"
            )

    return ask


def _folder(options: argparse.Namespace) -> Path:
    """Return the folder for bags and report. Raises InputError."""
    from worm_optimizer.operation.campaign_plan import PROMISES
    from worm_optimizer.report.report_page import PAGE

    if options.resume is not None:
        if options.output is not None:
            raise InputError("--resume names the folder: remove --output")
        resumed: Path = options.resume.resolve()
        if not _is_begun(options, resumed):
            raise InputError(f"{resumed}: contains no campaign ({PROMISES} is missing)")
        if (resumed / "report" / PAGE).exists():
            raise InputError(f"{resumed}: this campaign is complete and contains its report")
        return resumed
    default = Path("bags") / time.strftime("campaign_%Y_%m_%d-%H_%M_%S")
    folder: Path = (options.output or default).resolve()
    if folder.exists():
        raise InputError(
            f"{folder}: exists already; give another name with --output, or continue the campaign with --resume"
        )
    return folder


def _is_begun(options: argparse.Namespace, folder: Path) -> bool:
    """Return True if a folder contains a campaign that can be continued."""
    from worm_optimizer.operation.campaign_plan import PROMISES
    from worm_optimizer.operation.identification_runs import RUNS
    from worm_optimizer.operation.tuning_runs import TUNING

    identified = options.identify and (folder / RUNS).is_dir()
    return (folder / PROMISES).is_file() or identified or (folder / TUNING).is_dir()


def _hint(options: argparse.Namespace, folder: Path) -> str:
    """Return a line on how to continue an interrupted campaign; empty if nothing has begun."""
    return f"campaign: continue with --resume {folder}\n" if _is_begun(options, folder) else ""


def _promise(plan: Plan, folder: Path) -> None:
    """Write the predictions of a new campaign. If a continued campaign has other predictions, raise `InputError`."""
    from worm_optimizer.operation.campaign_plan import PROMISES, is_promised, write_promises

    folder.mkdir(parents=True, exist_ok=True)
    if not (folder / PROMISES).exists():
        write_promises(plan, folder)
    elif not is_promised(plan, folder):
        raise InputError(
            f"{folder}: this campaign has other predictions: use the options of its start again"
        )


def _print(
    options: argparse.Namespace,
    gaits: Sequence[RecordedGait],
    spreads: Sequence[Spread],
    folder: Path,
    page: Path,
    summary: dict[str, Any],
) -> None:
    from worm_optimizer.operation.spread import spread_table
    from worm_optimizer.report.agreement import QUANTITIES, agreement_json, describe

    judged = agreement_json(gaits)
    content = {
        "folder": str(folder),
        "page": str(page),
        **judged,
        "spread": [asdict(row) for row in spreads],
    }
    content["gaits"] = [
        {
            "name": row["name"],
            "measured": _values(row["measured"]),
            "expected": _values(row["expected"]),
            "nominal": {key: getattr(gait.expected.nominal, key) for key in QUANTITIES},
            "agrees": row["agrees"],
            "verdict": row["verdict"],
            "grooves": row["grooves"],
        }
        for row, gait in zip(judged["runs"], gaits, strict=True)
    ]
    files = {"recordings": folder, "report": page}
    if "parameter_file" in summary:
        files = {"parameters": summary["parameter_file"], **files}
    text = f"{describe(gaits)}\n\n{spread_table(spreads)}\n\n{labelled(files)}"
    print_result(options, content | summary, text)


def _values(bands: dict[str, Any]) -> dict[str, float]:
    return {quantity: band["value"] for quantity, band in bands.items()}


main = executable(_parser, _campaign)
