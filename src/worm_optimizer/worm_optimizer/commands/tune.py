# SPDX-License-Identifier: Apache-2.0
"""Command line: the next gait for a requested probability to keep the grooves, from the recorded runs so far."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from worm_model.commands.command_line import (
    InputError,
    Parser,
    executable,
    notifier,
    number,
    print_result,
)
from worm_model.commands.margin import add_grooves, measured_margins
from worm_model.gait import named_values
from worm_model.parameters import load_parameter_file
from worm_optimizer.commands.search_options import add_limit_options, chosen_settings

if TYPE_CHECKING:  # ROS, SciPy and Numba load slowly
    from worm_model.margin.measured_margin import RunMargin
    from worm_optimizer.operation.campaign_runs import Tuned
    from worm_optimizer.robustness.tuning import GaitLimits, Tuning


def _parser() -> Parser:
    parser = Parser(
        prog="tune",
        description="Measure the margins of recorded runs of one robot, and print the next gait to run: the smallest "
        "stroke, or a lower frequency, with which both fins keep their grooves with the requested probability.",
    )
    parser.add_argument(
        "bags",
        nargs="+",
        type=Path,
        metavar="BAG",
        help="recordings of one gait each, the last one last",
    )
    add_aim(parser)
    add_limit_options(parser)
    parser.add_parameters("the file in the bag, else the paper's values")
    parser.add_json()
    return parser


PROBABILITY = 0.99  # default


def add_aim(parser: Parser) -> None:
    """Add the probability and the grooves that a tuning is to reach."""
    parser.add_argument(
        "--probability",
        type=number,
        default=PROBABILITY,
        metavar="P",
        help=f"probability that a cycle keeps its grooves (default: {PROBABILITY})",
    )
    add_grooves(
        parser,
        "the most in any cycle of the runs but their first; of a requested gait, the predicted ones",
    )


def check_aim(options: argparse.Namespace) -> None:
    """Raise `InputError` if the options of `add_aim` are inadmissible."""
    if not 0.0 < options.probability < 1.0:
        raise InputError(f"--probability {options.probability:g}: give a number between 0 and 1")


@dataclass(frozen=True)
class Aim:
    """Aim of a tuning.

    Attributes:
        probability: requested probability that a cycle keeps its grooves.
        grooves: grooves per cycle to keep; None: the most in any cycle of the runs but their first.
        limits: limits of the robot.
        parameter_file: parameter file of the robot; empty: the file in the bag, else the paper's values.
    """

    probability: float
    grooves: int | None
    limits: GaitLimits
    parameter_file: str


def aim_of(options: argparse.Namespace, direction: int) -> Aim:
    """Return the aim that the options describe. Raises `InputError` if they are inadmissible."""
    from worm_optimizer.robustness.tuning import limits_of
    from worm_optimizer.search.front import task_of

    check_aim(options)
    content = load_parameter_file(options.parameters)
    limits = limits_of(task_of(content, chosen_settings(options), direction))
    return Aim(options.probability, options.grooves, limits, options.parameters)


def runs_of(bags: Sequence[Path], parameters: str, grooves: int | None) -> list[RunMargin]:
    """Return the last measured run of each bag, all for the same number of grooves."""
    twice = [
        bag for number, bag in enumerate(bags) if bag.resolve() in map(Path.resolve, bags[:number])
    ]
    if twice:
        raise InputError(f"{twice[0]}: given twice")
    notify = notifier("tune")
    first = [_last_run(bag, parameters, grooves, notify) for bag in bags]
    wanted = grooves or max(run.grooves for run in first)
    runs = [
        run if run.grooves == wanted else _last_run(bag, parameters, wanted, notify)
        for bag, run in zip(bags, first, strict=True)
    ]
    if len({run.gait.direction for run in runs}) > 1:
        raise InputError("the bags contain runs of both directions: tune each direction by itself")
    return runs


def _last_run(
    bag: Path, parameters: str, grooves: int | None, notify: Callable[[str], None]
) -> RunMargin:
    measured = measured_margins(bag, parameters, grooves, notify)
    if not measured:
        raise InputError(f"{bag}: no gait was run")
    return measured[-1]


def tuning_of(runs: Sequence[RunMargin], aim: Aim, last: Path) -> Tuning:
    """Return the next step of a tuning from its runs; raise `InputError` if the bag ``last`` was not measured."""
    from worm_optimizer.robustness.tuning import next_gait

    parameters = load_parameter_file(aim.parameter_file).parameters
    tuning = next_gait(runs, aim.probability, aim.limits, parameters)
    if tuning is None:
        later = runs[-1].cycles[1:]
        if later and not any(cycle.grooves for cycle in later):
            raise InputError(
                f"{last}: no groove was gained, so there is no margin: run a longer stroke"
            )
        raise InputError(
            f"{last}: the margin was not measured: the tracker must see both modules in at least three whole cycles"
        )
    return tuning


def measured_step(bags: Sequence[Path], aim: Aim, say: Callable[[str], None]) -> Tuning:
    """Return the next step of a tuning from the bags of its runs; ``say`` gets the last margins and the step."""
    runs = runs_of(bags, aim.parameter_file, aim.grooves)
    say(str(runs[-1]))
    tuning = tuning_of(runs, aim, bags[-1])
    say(described(tuning))
    return tuning


def tuning_json(tuning: Tuning) -> dict[str, Any]:
    """Return a step of a tuning as a JSON object."""
    return {
        "state": tuning.state.value,
        "gait": named_values(tuning.gait),
        "keeps_probability": asdict(tuning.keeps),
        "reason": tuning.reason,
    }


def tuned_json(tuned: Tuned) -> dict[str, Any]:
    """Return the last step of a tuning on a robot, and the bags of its runs, as a JSON object."""
    return {**tuning_json(tuned.step), "bags": [str(bag) for bag in tuned.bags]}


def described(tuning: Tuning) -> str:
    """Return a step of a tuning as a line."""
    gait = tuning.gait
    what = f"{tuning.state.value}: {gait.stroke * 1e3:.2f} mm, {gait.frequency:g} Hz"
    return f"{what}; a cycle keeps its grooves with {tuning.keeps}; {tuning.reason}"


def _tune(options: argparse.Namespace) -> None:
    runs = runs_of(options.bags, options.parameters, options.grooves)
    tuning = tuning_of(runs, aim_of(options, runs[-1].gait.direction), options.bags[-1])
    lines = [f"{bag}: {run}" for bag, run in zip(options.bags, runs, strict=True)]
    print_result(options, tuning_json(tuning), "\n".join([*lines, described(tuning)]))


main = executable(_parser, _tune)
