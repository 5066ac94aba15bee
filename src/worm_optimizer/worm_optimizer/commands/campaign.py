# SPDX-License-Identifier: Apache-2.0
"""Command line: the validation campaign, on the virtual robot or on a real one.

The functions import what they use, because these imports take seconds, and --help needs none of them.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Mapping
from dataclasses import replace
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
from worm_model.errors import IdentificationError, InputError
from worm_model.parameters import load_parameter_file
from worm_model.text_table import labelled
from worm_optimizer.commands.report import add_identification
from worm_optimizer.commands.search_options import add_campaign_options, chosen_settings
from worm_optimizer.commands.start import add_robot, robot_of
from worm_optimizer.commands.tune import PROBABILITY
from worm_optimizer.nodes.robot_client import OperatorError
from worm_optimizer.operation.bring_up import CYCLES, FAILURES, ProgressLog, Session, work_folder
from worm_optimizer.operation.processes import termination_as_interrupt
from worm_optimizer.operation.system import Robot
from worm_optimizer.robot_commands import GaitCommand

if TYPE_CHECKING:
    from worm_model.gait import Gait
    from worm_model.parameters import ParameterFile
    from worm_optimizer.gait_prediction import Prediction
    from worm_optimizer.operation.campaign_runs import Measure, Prepare
    from worm_optimizer.report.recorded_gait import RecordedGait
    from worm_optimizer.search.search_settings import Settings

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
        help="runs of each gait (default: 1); their spread is printed",
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
    add("--bellows", type=Path, metavar="CSV", help="bellows test: compression_m, force_N")
    add("--fin", type=Path, metavar="CSV", help="fin test: displacement_m, force_N")
    add_identification(parser)
    parser.add_json()
    parser.add_parameters()
    return parser


def _campaign(options: argparse.Namespace) -> int:
    load_parameter_file(options.parameters)
    load_parameter_file(options.identification)
    if options.repeats < 1:
        raise InputError(f"--repeats {options.repeats}: give 1 or more")
    if options.identify and options.identification:
        raise InputError("--identify creates the identification: remove --identification")
    _check_bench_tests(options)
    robot = robot_of(options, options.mode)
    folder = _folder(options)
    say = ProgressLog("campaign")
    try:
        with termination_as_interrupt(), work_folder("campaign") as work:
            robot = replace(robot, settings={"directory": str(work), **robot.settings})
            campaign = _Campaign(options, robot, folder, work / "logs", say)
            names = campaign.run()
    except FAILURES as error:
        sys.stderr.write(f"campaign: {error}\n{_hint(folder, options)}")
        return FAILED
    except KeyboardInterrupt:
        sys.stderr.write(_hint(folder, options))
        raise
    say("comparing")
    campaign.compare(names)
    return 0


def _check_bench_tests(options: argparse.Namespace) -> None:
    """Raise `InputError` if a bench test has no effect or cannot be read, before a node starts."""
    from worm_model.identification import bellows, fin
    from worm_model.identification.inputs import read_bench_test

    tests: tuple[tuple[str, Path | None, tuple[str, str], Callable[[Any, Any], object]], ...] = (
        ("--bellows", options.bellows, bellows.COLUMNS, bellows.fit_bellows),
        ("--fin", options.fin, fin.COLUMNS, fin.fit_fin),
    )
    for option, path, columns, fit in tests:
        if path is None:
            continue
        if not options.identify:
            raise InputError(f"{option} has no effect without --identify: give both")
        try:
            test = read_bench_test(path, columns)
            fit(test.x, test.y)
        except IdentificationError as error:
            raise InputError(f"{option} {path}: {error}") from None


class _Campaign:
    """Campaign of a robot.

    Args:
        options: command line. After an identification, it names the results of this identification.
        robot: the robot.
        folder: folder of bags and report.
        logs: folder of the log files.
        say: called with each line of progress.
    """

    def __init__(
        self,
        options: argparse.Namespace,
        robot: Robot,
        folder: Path,
        logs: Path,
        say: ProgressLog,
    ) -> None:
        self._options, self._robot, self._folder = options, robot, folder
        self._logs, self._say = logs, say
        self._summary: dict[str, Any] = {}  # of identification and tuning, for the output
        self._prompts = options.identify and options.mode == "robot"

    def run(self) -> dict[str, str]:
        """Identify the robot and tune its gaits as requested, then run all gaits.

        Return the name of the gait of each run, by the name of the run.
        """
        from worm_optimizer.operation.campaign_plan import make_plan, promise, run_names
        from worm_optimizer.operation.campaign_runs import at_once, run_gaits

        options = self._options
        if options.identify:
            self._identify()
        content = load_parameter_file(options.parameters)
        settings = replace(chosen_settings(options), conditions=self._robot.conditions)
        nominal = options.with_nominal or options.identify
        self._plan = make_plan(content, settings, options.direction, nominal=nominal)
        ask = _prompt("Put the robot where it has room") if self._prompts else at_once
        if options.tune:
            self._tune(content, settings, ask)
        promise(self._plan, self._folder)
        names = run_names(tuple(self._plan.gaits), options.repeats)
        orders = {
            run: GaitCommand(self._plan.gaits[name].gait, CYCLES) for run, name in names.items()
        }
        run_gaits(self._robot, orders, self._folder, self._logs, self._say, ask)
        return names

    def _tune(self, content: ParameterFile, settings: Settings, ask: Prepare) -> None:
        """Tune the three gaits of the plan on the robot, and predict the tuned gaits."""
        from worm_optimizer.commands.tune import Aim, measured_step, tuned_json
        from worm_optimizer.operation.campaign_runs import gait_recorder, tune_gaits
        from worm_optimizer.robustness.tuning import limits_of
        from worm_optimizer.search.front import predicted_gaits, task_of

        options, plan, say = self._options, self._plan, self._say
        limits = limits_of(task_of(content, settings, options.direction))

        def first(gait: Prediction) -> tuple[Gait, Measure]:
            grooves = round(gait.grooves_per_cycle)
            aim = Aim(options.probability or PROBABILITY, grooves, limits, options.parameters)
            return gait.gait, lambda bags: measured_step(bags, aim, say)

        three = {name: first(gait) for name, gait in plan.optimisation.front.three.items()}
        with gait_recorder(self._robot, self._logs, say, ask) as record:
            tuned = tune_gaits(three, record, self._folder, say)
        gaits = {name: each.step.gait for name, each in tuned.items()}
        predicted = predicted_gaits(gaits, content, settings)
        self._plan = replace(plan, gaits={**plan.gaits, **predicted})
        self._summary["tuning"] = {name: tuned_json(each) for name, each in tuned.items()}

    def _identify(self) -> None:
        """Record the missing runs, identify the parameters unless the results exist, and use the parameters."""
        from worm_optimizer.operation import identification_runs
        from worm_optimizer.operation.campaign_runs import put_aside, run_gaits

        options, folder, say = self._options, self._folder, self._say
        known = load_parameter_file(options.parameters)
        runs = folder / identification_runs.RUNS
        runs.mkdir(parents=True, exist_ok=True)
        pitch = known.parameters.pitch
        orders = identification_runs.identification_orders(options.direction, pitch)
        ask = _prompt(SAME_PLACE) if self._prompts else identification_runs.put_back
        run_gaits(self._robot, orders, runs, self._logs, say, ask)
        bags = [runs / name for name in orders]
        report, summary = folder / identification_runs.REPORT, folder / identification_runs.SUMMARY
        parameters = folder / identification_runs.PARAMETERS
        if not summary.exists():
            for left in (report, parameters):
                put_aside(left, say)  # incomplete results of an interrupted identification
            say("identifying")
            source = options.parameters or "the paper"
            bench = options.bellows, options.fin
            if options.mode == "virtual" and bench == (None, None):
                bench = identification_runs.virtual_bench(self._robot, folder, self._logs)
            result = identification_runs.identify_robot(
                bags, bench, (known, source), folder, StageProgress()
            )
            summary.write_text(json.dumps(finite(result)), encoding="utf-8")
        self._summary = json.loads(summary.read_text(encoding="utf-8"))
        self._summary |= {"parameter_file": str(parameters), "bags": [str(b) for b in bags]}
        options.parameters = str(parameters)
        options.identification = str(parameters)
        settings = {**self._robot.settings, "parameter_file": options.parameters}
        self._robot = replace(self._robot, settings=settings)

    def compare(self, names: Mapping[str, str]) -> None:
        """Write the report on the runs, whose gaits ``names`` contains by run, and print it."""
        from worm_optimizer.operation.campaign_plan import spread_table
        from worm_optimizer.operation.campaign_runs import put_aside
        from worm_optimizer.report.agreement import QUANTITIES, agreement_json, describe
        from worm_optimizer.report.recordings import read_recorded_gaits
        from worm_optimizer.report.report_page import Report, build_report

        options, plan = self._options, self._plan
        bags = [self._folder / run for run in names]
        recorded = read_recorded_gaits(bags, options.parameters, notifier("campaign"))
        title = f"Validation campaign ({options.mode} robot)"
        report = Report(title, recorded, plan.optimisation, identification=options.identification)
        put_aside(self._folder / "report", self._say)
        page = build_report(report, self._folder / "report")
        judged = agreement_json(recorded)
        gaits = [
            {
                **{name: row[name] for name in ("name", "agrees", "verdict", "grooves")},
                **{
                    source: {key: band["value"] for key, band in row[source].items()}
                    for source in ("measured", "expected")
                },
                "nominal": {key: getattr(gait.expected.nominal, key) for key in QUANTITIES},
            }
            for row, gait in zip(judged["runs"], recorded, strict=True)
        ]
        places = {"folder": str(self._folder), "page": str(page)}
        runs: dict[str, list[RecordedGait]] = defaultdict(list)
        for name, gait in zip(names.values(), recorded, strict=True):
            runs[name].append(gait)
        files = {"recordings": self._folder, "report": page}
        if "parameter_file" in self._summary:
            files = {"parameters": self._summary["parameter_file"], **files}
        text = f"{describe(recorded)}\n\n{spread_table(plan.gaits, runs)}\n\n{labelled(files)}"
        print_result(options, {**places, **judged, "gaits": gaits, **self._summary}, text)


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
    from worm_optimizer.report.report_page import PAGE

    if options.resume is not None:
        if options.output is not None:
            raise InputError("--resume names the folder: remove --output")
        resumed: Path = options.resume.resolve()
        if not _is_begun(resumed, options):
            raise InputError(f"{resumed}: contains no campaign")
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


def _is_begun(folder: Path, options: argparse.Namespace) -> bool:
    """Return True if a folder contains a campaign that can be continued."""
    from worm_optimizer.operation.campaign_plan import PROMISES
    from worm_optimizer.operation.campaign_runs import TUNING
    from worm_optimizer.operation.identification_runs import RUNS

    names = (PROMISES, TUNING, *((RUNS,) if options.identify else ()))
    return any((folder / name).exists() for name in names)


def _hint(folder: Path, options: argparse.Namespace) -> str:
    """Return a line on how to continue an interrupted campaign; empty if nothing has begun."""
    return f"campaign: continue with --resume {folder}\n" if _is_begun(folder, options) else ""


main = executable(_parser, _campaign)
