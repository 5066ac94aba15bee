# SPDX-License-Identifier: Apache-2.0
"""What the command lines of this package share: their options, and the settings that these make."""

from __future__ import annotations

import argparse
import dataclasses
import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from worm_model.commands.command_line import (
    InputError,
    Parser,
    Progress,
    add_parameters,
    new_file,
    number,
    run_command,
)
from worm_model.gait import FORWARD, REVERSE
from worm_optimizer.robustness.prediction import Prediction
from worm_optimizer.search import front as pipeline
from worm_optimizer.search.actuator_limits import ActuatorLimits
from worm_optimizer.search.cache import Cache, default_directory
from worm_optimizer.search.nsga2 import SearchSettings
from worm_optimizer.search.optimizer_errors import OptimizerError
from worm_optimizer.search.search_settings import Robustness, ScanSettings, Settings
from worm_optimizer.search.servo_limits import servo_models, within
from worm_optimizer.search.task import Bounds

_FIGURE_FORMATS = (".png", ".pdf", ".svg")
_BOX, _SCAN, _SEARCH, _PLAIN = Bounds(), ScanSettings(), SearchSettings(), Settings()


def add_common(parser: Parser) -> None:
    """Adds what every command takes: model, direction, box, limits, scan, cache, output."""
    add = parser.add_argument
    add("--direction", type=int, default=FORWARD, choices=(FORWARD, REVERSE), help="default 1")
    strokes = (_BOX.stroke_low, _BOX.stroke_high)
    _add_pair(parser, "--strokes", strokes, "bounds of the stroke in m")
    frequencies = (_BOX.frequency_low, _BOX.frequency_high)
    _add_pair(parser, "--frequencies", frequencies, "bounds of the frequency in Hz")
    _add_limits(parser)
    _add_number(parser, "--lowest", _SCAN.lowest, "lowest margin of the scan in m")
    _add_number(parser, "--highest", _SCAN.highest, "highest margin of the scan in m")
    _add_number(parser, "--step", _SCAN.step, "step between the scan's margins in m")
    add("--cache", metavar="DIR", help="where results are kept (default: in ~/.cache)")
    add("--figure", metavar="FILE", help="write a figure (.png, .pdf or .svg)")
    add("--json", action="store_true", help="print one JSON object")
    add_parameters(parser)


def _add_limits(parser: Parser) -> None:
    add = parser.add_argument
    _add_number(parser, "--max-cable-speed", math.inf, "greatest cable speed in m/s")
    _add_number(parser, "--max-cable-force", math.inf, "greatest cable force in N")
    _add_number(parser, "--max-power", math.inf, "greatest electrical power in W")
    add(
        "--limits-from",
        default="",
        metavar="FILE",
        help="the driver's parameter file: gaits keep its limits too",
    )
    add(
        "--servo-model",
        default="",
        metavar="NAME",
        help=f"with --limits-from: of the cable servos ({', '.join(servo_models())})",
    )
    add(
        "--supply-voltage",
        type=number,
        default=None,
        metavar="V",
        help="with --limits-from: of the servos (default: what their manual recommends)",
    )


def add_search(parser: Parser) -> None:
    """Adds what decides about a front."""
    kinds = [kind.value for kind in Robustness]
    parser.add_argument(
        "--margin",
        type=number,
        default=None,
        metavar="M",
        help="robustness margin in m (default: at the cliff of the margin scan)",
    )
    parser.add_argument(
        "--robustness",
        choices=kinds,
        default=Robustness.MARGIN.value,
        help="what keeps gaits robust: an enlarged threshold (margin, the default), a probability "
        "of keeping the promised grooves (chance), or keeping them at every groove phase (any_phase)",
    )
    _add_number(parser, "--probability", _PLAIN.probability, "the probability of chance")
    for name, default in (
        ("population", _SEARCH.population),
        ("generations", _SEARCH.generations),
        ("seed", _SEARCH.seed),
        ("samples", _PLAIN.samples),
    ):
        parser.add_argument(
            f"--{name}", type=int, default=default, metavar="N", help=f"default {default}"
        )


def _add_number(parser: Parser, name: str, default: float, meaning: str) -> None:
    told = "no limit" if math.isinf(default) else f"{default:g}"
    parser.add_argument(
        name, type=number, default=default, metavar="X", help=f"{meaning} (default: {told})"
    )


def _add_pair(parser: Parser, name: str, default: tuple[float, float], meaning: str) -> None:
    parser.add_argument(
        name,
        type=number,
        nargs=2,
        default=default,
        metavar=("LOW", "HIGH"),
        help=f"{meaning} (default: {default[0]:g} {default[1]:g})",
    )


def common_settings(options: argparse.Namespace) -> Settings:
    """The settings of `add_common`; raises `OptimizerError` if they are not admissible."""
    bounds, limits = within(
        Bounds(*options.strokes, *options.frequencies),
        ActuatorLimits(options.max_cable_speed, options.max_cable_force, options.max_power),
        *(options.limits_from, options.servo_model, options.supply_voltage),
    )
    return Settings(
        bounds=bounds,
        limits=limits,
        scan=ScanSettings(options.lowest, options.highest, options.step),
    )


def front_settings(options: argparse.Namespace) -> Settings:
    """The settings of `add_common` and `add_search`; raises `OptimizerError` likewise."""
    return dataclasses.replace(
        common_settings(options),
        search=SearchSettings(options.population, options.generations, options.seed),
        robustness=Robustness(options.robustness),
        margin=options.margin,
        probability=options.probability,
        samples=options.samples,
    )


def cache_of(options: argparse.Namespace) -> Cache:
    """The cache that is asked for; raises `OptimizerError` if it cannot be written to."""
    return Cache.at(Path(options.cache).expanduser() if options.cache else default_directory())


def figure_file(options: argparse.Namespace) -> Path | None:
    """The figure's new file, if one is asked for; raises `InputError` if it cannot be made."""
    if options.figure is None:
        return None
    path = new_file(options.figure)
    if path.suffix.lower() not in _FIGURE_FORMATS:
        raise InputError(f"--figure {path}: end its name in {', '.join(_FIGURE_FORMATS)}")
    return path


def shown_progress(title: str) -> pipeline.Report:
    """A report that shows its progress on standard error."""
    bar = Progress(title)
    return lambda progress: bar(progress.fraction)


def gait_json(gait: Prediction) -> dict[str, Any]:
    """A gait as the machine-readable output has it; its speed counts along its direction."""
    return dataclasses.asdict(gait)


def run(parser: Parser, command: Callable[[argparse.Namespace], int | None]) -> int:
    """`run_command` for commands that raise `OptimizerError` on bad input."""

    def translated(options: argparse.Namespace) -> int | None:
        try:
            return command(options)
        except OptimizerError as error:
            raise InputError(str(error)) from None

    return run_command(parser, translated)


def say(text: str) -> None:
    """Prints the result of a command."""
    sys.stdout.write(text + "\n")
