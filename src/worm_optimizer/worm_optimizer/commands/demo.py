# SPDX-License-Identifier: Apache-2.0
"""Command line: demonstration of the whole software on a virtual robot.

The command starts the node graph of system.yaml, each node as a process. It requests a gait, runs and records five
cycles, stops the robot, replays the recording with the twin, and compares measurements with predictions.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from worm_model.commands.command_line import FAILED, Parser, executable, notifier, print_result
from worm_model.errors import RecordingError
from worm_model.parameters import load_parameter_file
from worm_model.text_table import labelled, text_table
from worm_optimizer.gait_prediction import Prediction
from worm_optimizer.operation import bring_up
from worm_optimizer.operation.processes import termination_as_interrupt
from worm_optimizer.operation.system import RECORDER, installed_system_file
from worm_optimizer.robot_commands import GaitCommand
from worm_optimizer.search.gait_request import GaitRequest, Objective

if TYPE_CHECKING:  # matplotlib, SciPy and Numba load slowly
    from worm_optimizer.report.recorded_gait import RecordedGait

#: Values of the comparison by name, each with the factor and the format of its text
_QUANTITIES = {
    "speed": (1e3, "{:.2f} mm/s"),
    "power": (1.0, "{:.2f} W"),
    "cost_of_transport": (1.0, "{:.1f}"),
}


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
    new = bring_up.new_bag(options.bags, "demo")
    say = bring_up.ProgressLog("demo")
    try:
        with termination_as_interrupt():
            prediction, bag = _drive(options, new, say)
            say("replaying the recording with the twin")
            _report(options, prediction, bag)
    except bring_up.FAILURES as error:
        print(f"demo: {error}", file=sys.stderr)  # noqa: T201
        return FAILED
    return 0


def _drive(options: argparse.Namespace, bag: Path, say: bring_up.Say) -> tuple[Prediction, Path]:
    """Start the nodes, run five cycles of the optimizer's cruise gait, and end all processes.

    Return the prediction and the bag, which is then closed.
    """
    with bring_up.work_folder("demo") as folder:
        settings = {
            "directory": str(folder),
            "bag": str(bag),
            "seed": str(options.seed),
            "rate": "2",  # times real time, for a short demo
        }
        files = {"parameter_file": options.parameters, "plant": options.plant}
        settings |= {name: str(Path(file).resolve()) for name, file in files.items() if file}
        system = installed_system_file().system("virtual", **settings)
        with bring_up.session(system, folder / "logs", say) as running:
            node, cycles = running.node, bring_up.CYCLES
            prediction, _ = node.request_gait(GaitRequest(Objective.CRUISE))
            gait = prediction.gait
            say(f"the optimizer answers: {_title(prediction)}")
            bag = bring_up.bag_of(running.group.processes[RECORDER])
            running.activate()
            node.wait_for_recorder(RECORDER)
            say(f"running {cycles} cycles, {cycles / gait.frequency:.0f} s of the robot's time")
            running.run_gait(GaitCommand(gait, cycles))
            running.release()
        return prediction, bag


def _title(prediction: Prediction) -> str:
    gait = prediction.gait
    return (
        f"stroke {1e3 * gait.stroke:.1f} mm, frequency {gait.frequency:.3f} Hz, "
        f"margin {1e3 * gait.margin:.1f} mm"
    )


def compare(gait: RecordedGait, prediction: Prediction) -> dict[str, dict[str, float]]:
    """Return speed (m/s), power (W) and cost of transport by source: ``measured``, ``twin``, ``predicted``, ``robust``.

    ``predicted`` and ``robust`` are the optimizer's predictions before the run, without and with the margin.
    """
    for problem in (gait.early_end, *gait.missing):
        if problem:
            raise RecordingError(problem)
    if math.isnan(gait.twin.speed.value) or math.isnan(gait.twin.power.value):
        raise RecordingError("the twin did not follow the recording over the averaged cycles")
    return {
        "measured": {name: getattr(gait.measured, name).value for name in _QUANTITIES},
        "twin": {name: getattr(gait.twin, name).value for name in _QUANTITIES},
        "predicted": {name: getattr(prediction, f"nominal_{name}") for name in _QUANTITIES},
        "robust": {name: getattr(prediction, name) for name in _QUANTITIES},
    }


def _report(options: argparse.Namespace, prediction: Prediction, bag: Path) -> None:
    """Replay the recording with the twin, write its figure next to the bag, and print the comparison."""
    from worm_model.analysis.plot_style import save_figure
    from worm_model.analysis.run_curves import plot_run
    from worm_optimizer.report.recordings import read_recorded_gaits

    gait = read_recorded_gaits([bag], options.parameters, notifier("demo"))[-1]
    compared, figure = compare(gait, prediction), bag.with_suffix(".png")
    save_figure(
        plot_run(gait.run, gait.replay, gait.content.parameters, _title(prediction)), figure
    )
    content = {
        "gait": asdict(prediction),
        "window": asdict(gait.window),
        **compared,
        "bag": str(bag),
        "figure": str(figure),
    }
    names = {
        "measured": "measured on the robot",
        "twin": "twin, driven by the recording",
        "predicted": "optimizer, before the run",
        "robust": f"optimizer, with {1e3 * prediction.margin:.1f} mm margin",
    }
    rows = [["", "speed", "", "power", "", "cost of transport", ""]]
    rows += [[name, *_cells(compared[key], compared["measured"])] for key, name in names.items()]
    text = (
        f"Last 3 of 5 cycles, {_title(prediction)}; predictions for a groove phase of "
        f"{1e3 * prediction.groove_phase:.1f} mm:\n\n{text_table(rows)}\n\n"
        f"{labelled({'recording': bag, 'figure': figure})}"
    )
    print_result(options, content, text)


def _cells(values: Mapping[str, float], measured: Mapping[str, float]) -> Iterator[str]:
    """Yield each value with its unit, and its relative difference from the measured value, in percent."""
    for name, (scale, shown) in _QUANTITIES.items():
        yield shown.format(scale * values[name])
        difference = (values[name] - measured[name]) / abs(measured[name])
        yield "" if values is measured else f"{100.0 * difference:+.1f} %"


main = executable(_parser, _demo)
