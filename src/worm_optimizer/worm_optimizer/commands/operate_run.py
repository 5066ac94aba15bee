# SPDX-License-Identifier: Apache-2.0
"""The actions `operate run` and `operate tune`: a given or requested gait, once or until its margin suffices."""

from __future__ import annotations

import argparse
import sys
from contextlib import AbstractContextManager, nullcontext
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING

from worm_model.commands.command_line import FAILED, InputError, Parser, number, print_result
from worm_model.run import Activity
from worm_model.text_table import labelled
from worm_msgs.conditions import CONDITION_ROWS, LEVEL, Conditions
from worm_msgs.gait import GAIT_DEFAULTS, WAVEFORM, Gait, gait_of
from worm_optimizer.commands.request import add_objective, request_of_options
from worm_optimizer.commands.tune import (
    Aim,
    add_aim,
    check_aim,
    described,
    measured_step,
    tuned_json,
)
from worm_optimizer.gait_prediction import Prediction
from worm_optimizer.nodes.operator_node import (
    DRIVER,
    GaitFailedError,
    OperatorNode,
    RejectedStartError,
)
from worm_optimizer.operation.bring_up import (
    CYCLES,
    ProgressLog,
    new_bag,
    once_per_cycle,
    recorded,
)
from worm_optimizer.operation.processes import counted_interrupts
from worm_optimizer.operation.system import recorder_of
from worm_optimizer.robot_commands import GaitCommand, RunResult

if TYPE_CHECKING:  # Numba loads slowly
    from worm_optimizer.operation.campaign_runs import Tuned
    from worm_optimizer.robustness.tuning import GaitLimits


def add_run(parser: Parser) -> None:
    """Add the options of `run`."""
    parser.add_gait()
    add_objective(parser)
    parser.add_conditions(None)
    ends = parser.add_argument_group("end of the run: the first that is reached")
    ends.add_argument(
        "--cycles", type=int, default=0, metavar="N", help=f"default {CYCLES} if no end is given"
    )
    ends.add_argument("--grooves", type=int, default=0, metavar="N", help="needs a tracker")
    ends.add_argument(
        "--distance", type=number, default=0.0, metavar="M", help="in m; needs a tracker"
    )
    parser.add_argument(
        "--record", type=Path, metavar="FOLDER", help="record the run into a new bag in this folder"
    )
    parser.add_parameters()


def check_run(options: argparse.Namespace) -> None:
    """Raise `InputError` for inadmissible options, before anything is requested."""
    _ends(options, own_gait(options) or Gait(0.05, 0.1))


def run(node: OperatorNode, options: argparse.Namespace) -> int:
    """Run the gait of the options to its end, and print the result."""
    say = ProgressLog("operate")
    conditions = conditions_of(node, options, say)
    command = _ends(options, own_gait(options) or requested(node, options, say).gait)
    recording: AbstractContextManager[Path | None] = nullcontext()
    if options.record is not None:
        new = new_bag(options.record)
        recording = recorded(
            node, recorder_of(node.get_namespace(), new, options.parameters, conditions)
        )
    say(f"running {command}")
    with recording as bag:
        result = attended(node, command, say)
    content = {**asdict(result), "bag": None if bag is None else str(bag)}
    print_result(options, content, _result_text(result, bag))
    if not result.success:
        print(f"operate: {result.message}", file=sys.stderr)  # noqa: T201
    return 0 if result.success else FAILED


def conditions_of(node: OperatorNode, options: argparse.Namespace, say: ProgressLog) -> Conditions:
    """Send the conditions in the options to twin and optimizer, and return the conditions of the optimizer.

    Without an optimizer, send nothing and return the conditions in the options. Do not search for one if neither a
    recording nor a requested gait depends on the conditions.
    """
    stated = {
        name: value for name in CONDITION_ROWS if (value := getattr(options, name)) is not None
    }
    if not stated and options.record is None and options.stroke is not None:
        return LEVEL
    if not node.has_optimizer():
        say("no optimizer is running: the recording contains the conditions of the options")
        return Conditions(**stated)
    if stated:
        node.set_model_parameters(stated)
    conditions = node.conditions()
    if conditions != LEVEL:
        say(f"conditions: {conditions}")
    return conditions


def own_gait(options: argparse.Namespace) -> Gait | None:
    """Return the gait that the options define; None if a gait must be requested instead. Raises `InputError`."""
    if options.stroke is None and options.frequency is None:
        for name in WAVEFORM:
            if name in GAIT_DEFAULTS and str(getattr(options, name)) != str(GAIT_DEFAULTS[name]):
                option = f"--{name.replace('_', '-')}"
                raise InputError(f"{option} needs a gait in numbers: give --stroke and --frequency")
        return None
    if options.stroke is None or options.frequency is None:
        raise InputError("a gait has a stroke and a frequency: give --stroke and --frequency")
    if (options.objective, options.speed, options.power) != (None, None, None):
        raise InputError(
            "--stroke and --frequency define the gait: omit --objective, --speed and --power"
        )
    return gait_of(options)


def _ends(options: argparse.Namespace, gait: Gait) -> GaitCommand:
    """Return a command for a gait with the ends in the options. Raises `InputError`.

    If the options contain no end, the run ends after `CYCLES` cycles.
    """
    default = 0 if options.grooves or options.distance else CYCLES
    return GaitCommand(gait, options.cycles or default, options.grooves, options.distance)


def requested(node: OperatorNode, options: argparse.Namespace, say: ProgressLog) -> Prediction:
    """Request a gait from the optimizer.

    The request contains the initial length in the twin's latest state, if there is a twin.
    """
    twin = node.current_snapshot().twin
    length = 0.0 if twin is None else twin.initial_length
    answer, _ = node.request_gait(request_of_options(options), options.direction, length)
    phase = 1e3 * answer.groove_phase
    say(f"{1e3 * answer.nominal_speed:.2f} mm/s expected at a groove phase of {phase:+.1f} mm")
    return answer


def attended(node: OperatorNode, command: GaitCommand, say: ProgressLog) -> RunResult:
    """Run a gait to its end. Ctrl-C stops it at the next point of rest; a second Ctrl-C holds immediately."""
    progress = once_per_cycle(say)
    with counted_interrupts() as interrupts, node.started(command) as run:
        if not node.follow(run, progress, lambda: interrupts() > 0):
            run.cancel()
            say("stopping at the next point of rest; Ctrl-C again holds immediately")
        if not node.follow(run, progress, lambda: interrupts() > 1):
            say(node.stop())
        node.follow(run, progress)
    if run.rejected:
        driver = node.current_snapshot().driver
        ready = driver is not None and driver.state == Activity.IDLE and not driver.emergency_stop
        raise InputError(run.result.message) if ready else RejectedStartError(run.result.message)
    return run.result


def _result_text(result: RunResult, bag: Path | None) -> str:
    recording = {} if bag is None else {"recording": bag}
    if not result.cycles_completed:
        return f"{result.message}\n{labelled(recording)}".rstrip()
    rows = {
        "cycles": result.cycles_completed,
        "distance": f"{1e3 * result.distance:.1f} mm, {result.grooves:.1f} grooves",
        "speed": f"{1e3 * result.speed:.2f} mm/s",
        "power": f"{result.power:.2f} W, at rest {result.idle_power:.2f} W",
        "cost of transport": f"{result.cost_of_transport:.1f}",
        **recording,
    }
    return f"{result.message}\n{labelled(rows)}"


_LIMITS = ("limits.max_stroke_m", "limits.max_cable_speed_m_per_s")
_ROUNDING = 1e-4  # of a stroke, m


def add_tune(parser: Parser) -> None:
    """Add the options of `tune`."""
    parser.add_gait()
    add_objective(parser)
    add_aim(parser)
    parser.add_conditions(None)
    parser.add_argument(
        "--record",
        type=Path,
        default=Path("bags"),
        metavar="FOLDER",
        help="record each run into a new bag in this folder (default: bags)",
    )
    parser.add_parameters()


def check_tune(options: argparse.Namespace) -> None:
    """Raise `InputError` for inadmissible options, before anything is requested."""
    own_gait(options)
    check_aim(options)


def tune(node: OperatorNode, options: argparse.Namespace) -> int:
    """Tune the gait of the options on the robot, and print the last step."""
    from worm_optimizer.operation.campaign_runs import tune_gait  # here: Numba loads slowly

    say = ProgressLog("operate")
    node.require_tracker()
    conditions = conditions_of(node, options, say)
    gait, aim = _first_step(node, options, say)

    def record(gait: Gait, number: int) -> Path:
        bag = new_bag(options.record, "tune")
        recorder = recorder_of(node.get_namespace(), bag, options.parameters, conditions)
        with recorded(node, recorder) as path:
            result = attended(node, GaitCommand(gait, CYCLES), say)
        if not result.success:
            raise GaitFailedError(f"run {number}: {result.message}")
        return path

    tuned = tune_gait(gait, record, lambda bags: measured_step(bags, aim, say), say)
    return _print_tuned(options, tuned)


def _first_step(
    node: OperatorNode, options: argparse.Namespace, say: ProgressLog
) -> tuple[Gait, Aim]:
    """Return the first gait and the aim. A requested gait is to keep the grooves that the optimizer predicts."""
    aim = Aim(options.probability, options.grooves, _limits(node), options.parameters)
    own = own_gait(options)
    if own is not None:
        return own, aim
    answer = requested(node, options, say)
    return answer.gait, replace(aim, grooves=aim.grooves or round(answer.grooves_per_cycle))


def _limits(node: OperatorNode) -> GaitLimits:
    """Return the limits of the driver, less the rounding of a tuned gait."""
    from worm_optimizer.robustness.tuning import GaitLimits

    reach, speed = node.numbers(DRIVER, _LIMITS)
    return GaitLimits(
        lambda gait: min(reach - gait.pretension, speed * gait.stroke / gait.peak_speed) - _ROUNDING
    )


def _print_tuned(options: argparse.Namespace, tuned: Tuned) -> int:
    from worm_optimizer.robustness.tuning import TuneState

    step = tuned.step
    print_result(options, tuned_json(tuned), "\n".join([*map(str, tuned.bags), described(step)]))
    if step.state is TuneState.DONE:
        return 0
    if step.state is TuneState.RUN:
        text = f"not done after {len(tuned.bags)} runs; continue with the gait that is printed"
        print(f"operate: {text}", file=sys.stderr)  # noqa: T201
    else:
        print(f"operate: impossible: {step.reason}", file=sys.stderr)  # noqa: T201
    return FAILED
