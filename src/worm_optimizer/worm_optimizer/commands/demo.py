# SPDX-License-Identifier: Apache-2.0
"""Command line: demonstration of the whole software on a virtual robot.

The command starts the node graph of system.yaml, each node as a process. It requests a gait, runs and records five
cycles, stops the robot, replays the recording with the twin, and compares measurements with predictions.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from worm_model.commands.command_line import FAILED, Parser, notifier, print_result, run_command
from worm_model.parameters import load_parameter_file
from worm_model.text_table import labelled
from worm_optimizer.gait_prediction import Prediction
from worm_optimizer.operation.bring_up import FAILURES, ProgressLog, Say, work_folder
from worm_optimizer.operation.processes import termination_as_interrupt
from worm_optimizer.operation.recorded_run import new_bag
from worm_optimizer.operation.system import installed_system_file

if TYPE_CHECKING:  # matplotlib, SciPy and Numba load slowly
    from worm_optimizer.operation.demo_run import Comparison


def main(arguments: list[str] | None = None) -> int:
    """Run the demo, and return the exit status: 0 after success, 1 if a stage failed, or 2 for bad input."""
    return run_command(_parser(), _demo, arguments)


def _parser() -> Parser:
    parser = Parser(
        prog="demo",
        description="Request a gait, run and record it on a virtual robot, replay the recording with the twin, and "
        "compare measurements with predictions.",
    )
    parser.add_parameters()
    parser.add_argument(
        "--bags",
        type=Path,
        default=Path("bags"),
        metavar="FOLDER",
        help="folder for the recording and its figure (default: bags)",
    )
    parser.add_argument(
        "--plant",
        default="",
        metavar="FILE",
        help="file with the true parameters of the virtual robot (default: the installed virtual_robot.yaml)",
    )
    parser.add_argument("--seed", type=int, default=1, help="seed of the robot's scatter and noise")
    parser.add_json()
    return parser


def _demo(options: argparse.Namespace) -> int:
    load_parameter_file(options.parameters)  # raises errors in the file before any node starts
    new = new_bag(options.bags, "demo")
    say = ProgressLog("demo")
    try:
        with termination_as_interrupt():
            prediction, bag = _drive(options, new, say)
            say("replaying the recording with the twin")
            comparison, figure = _look_back(bag, prediction, options.parameters)
    except FAILURES as error:
        print(f"demo: {error}", file=sys.stderr)  # noqa: T201
        return FAILED
    _print(options, prediction, comparison, bag, figure)
    return 0


def _drive(options: argparse.Namespace, bag: Path, say: Say) -> tuple[Prediction, Path]:
    from worm_optimizer.operation.demo_run import run_demo_gait

    with work_folder("demo") as folder:
        settings = {
            "directory": str(folder),
            "bag": str(bag),
            "parameter_file": _absolute(options.parameters),
            "plant": _absolute(options.plant),
            "seed": str(options.seed),
            "rate": "2",  # times real time, for a short demo
        }
        system = installed_system_file().system("virtual", **settings)
        return run_demo_gait(system, folder / "logs", say)


def _absolute(path: str) -> str:
    return str(Path(path).resolve()) if path else ""


def _look_back(bag: Path, prediction: Prediction, parameter_file: str) -> tuple[Comparison, Path]:
    """Replay a recording with the twin, compare it with the prediction, and write the figure next to the bag."""
    from worm_model.analysis.plot_style import save_figure
    from worm_model.analysis.run_curves import plot_run
    from worm_optimizer.operation.demo_run import compare
    from worm_optimizer.report.recordings import read_recorded_gaits

    gait = read_recorded_gaits([bag], parameter_file, notifier("demo"))[-1]
    comparison, figure = compare(gait, prediction), bag.with_suffix(".png")
    title, parameters = _title(prediction), gait.content.parameters
    save_figure(plot_run(gait.run, gait.replay, parameters, title), figure)
    return comparison, figure


def _title(prediction: Prediction) -> str:
    gait = prediction.gait
    return (
        f"stroke {1e3 * gait.stroke:.1f} mm, frequency {gait.frequency:.3f} Hz, "
        f"margin {1e3 * gait.margin:.1f} mm"
    )


def _print(
    options: argparse.Namespace,
    prediction: Prediction,
    comparison: Comparison,
    bag: Path,
    figure: Path,
) -> None:
    from worm_optimizer.operation.demo_run import comparison_table

    content = {
        "gait": asdict(prediction),
        **asdict(comparison),
        "bag": str(bag),
        "figure": str(figure),
    }
    phase = 1e3 * prediction.groove_phase
    predictions = {
        "twin, driven by the recording": comparison.twin,
        "optimizer, before the run": comparison.predicted,
        f"optimizer, with {1e3 * prediction.margin:.1f} mm margin": comparison.robust,
    }
    text = (
        f"Last 3 of 5 cycles, {_title(prediction)}; predictions for a groove phase of "
        f"{phase:.1f} mm:\n\n{comparison_table(comparison.measured, predictions)}\n\n"
        f"{labelled({'recording': bag, 'figure': figure})}"
    )
    print_result(options, content, text)
