# SPDX-License-Identifier: Apache-2.0
"""Command line: the margin of each cycle of recorded runs, measured from the tracker."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from worm_model.commands.command_line import (
    Parser,
    executable,
    notifier,
    print_result,
)
from worm_model.errors import RecordingError
from worm_model.text_table import text_table

if TYPE_CHECKING:
    from worm_model.margin.measured_margin import FinMargin, RunMargin


def _parser() -> Parser:
    parser = Parser(
        prog="margin",
        description="Measure what each cycle of a run had to spare before a fin would have missed its groove, and the "
        "probability that a cycle keeps its grooves.",
    )
    parser.add_argument("bags", nargs="+", type=Path, metavar="BAG", help="a recording")
    add_grooves(parser, "the most in any cycle but the first")
    parser.add_parameters("the file in the bag, else the paper's values")
    parser.add_json()
    return parser


def add_grooves(parser: Parser, default: str) -> None:
    """Add the grooves per cycle that a margin refers to."""
    parser.add_argument(
        "--grooves",
        type=count,
        metavar="N",
        help=f"grooves per cycle to keep, 1 or more (default: {default})",
    )


def count(text: str) -> int:
    """Convert a command-line argument to a positive whole number; a ``type`` for argparse."""
    if int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text}: give 1 or more")
    return int(text)


def measured_margins(
    path: Path, parameters: str, grooves: int | None, notify: Callable[[str], None]
) -> list[RunMargin]:
    """Return the measured margins of the runs of a bag; ``notify`` gets what the bag lacks."""
    from worm_model.analysis.run_metrics import measure_margin  # here: SciPy and Numba load slowly
    from worm_model.analysis.run_parts import parts_of
    from worm_model.bags.opening import open_bag
    from worm_model.bags.recording.run_manifest import recorded_robot
    from worm_model.bags.run_reader import read_run
    from worm_model.bags.worm_topics import REPLAY_INPUTS

    with open_bag(path, notify) as bag:
        run = read_run(bag, names=REPLAY_INPUTS)
        values = recorded_robot(bag, parameters).parameters
    found = []
    for part in parts_of(run):
        with suppress(RecordingError):
            found.append(measure_margin(part.run, values, grooves))
    return found


def _margin(options: argparse.Namespace) -> None:
    notify = notifier("margin")
    runs = [
        (path, run)
        for path in options.bags
        for run in measured_margins(path, options.parameters, options.grooves, notify)
    ]
    result = {"runs": [{"bag": str(path), **run.as_json()} for path, run in runs]}
    print_result(
        options, result, "\n\n".join(_described(*pair) for pair in runs) or "no gait was run"
    )


def _described(path: Path, run: RunMargin) -> str:
    """Return the margins of a run as text."""
    head = f"{path}: {run.gait.stroke * 1e3:.1f} mm, {run.gait.frequency:g} Hz"
    if not run.source:
        return f"{head}: not measured; the tracker must see both modules in most of the run"
    columns = [(fin, name) for name in ("length", "margin") for fin in ("rear", "front")]
    titles = ["cycle", "grooves", *(f"{fin} {name} mm" for fin, name in columns)]
    rows = [
        [str(c.cycle), str(c.grooves), *(_both(getattr(c, fin), name) for fin, name in columns)]
        for c in run.cycles
    ]
    return f"{head}\n{text_table([titles, *rows])}\n{run}"


def _both(fin: FinMargin, name: str) -> str:
    value, sd = getattr(fin, name), getattr(fin, f"{name}_sd")
    return f"{value * 1e3:.1f} ± {sd * 1e3:.1f}" if math.isfinite(value) else "-"


main = executable(_parser, _margin)
